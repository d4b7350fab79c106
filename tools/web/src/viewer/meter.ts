import type { ByteRange } from "../container/scene_index.js";
import { SourceError } from "../errors.js";
import type { Answer, ByteSource, ReadOptions } from "../loader/byte_source.js";

/** Counts the bytes that come, and where a rate is set lets them come no faster. */
export class Meter {
  /** Bytes that have come. */
  bytes = 0;
  /** When the first of them came, by `performance.now`. */
  since: number | undefined;
  /** Most bits a second; Infinity as fast as they come. */
  bitsPerSecond = Infinity;
  /** When all bytes so far would have come at the rate, ms. */
  private due = 0;

  /** Count from nothing on. */
  reset(): void {
    this.bytes = 0;
    this.since = undefined;
  }

  /** The same parts, counted, and no faster than the rate. */
  async *through(parts: AsyncIterable<Uint8Array>): AsyncGenerator<Uint8Array> {
    for await (const part of parts) {
      const now = performance.now();
      this.since ??= now;
      this.due = Math.max(this.due, now) + (8000 * part.length) / this.bitsPerSecond;
      if (this.due > now) await new Promise((resolve) => setTimeout(resolve, this.due - now));
      this.bytes += part.length;
      yield part;
    }
  }
}

/** A source whose bytes go through a meter. */
export class MeteredSource implements ByteSource {
  constructor(
    private readonly source: ByteSource,
    private readonly meter: Meter,
  ) {}

  async read(range: ByteRange, options?: ReadOptions): Promise<Answer> {
    const answer = await this.source.read(range, options);
    return { ...answer, parts: this.meter.through(answer.parts) };
  }

  beside(name: string): ByteSource {
    if (this.source.beside === undefined) throw new SourceError(`${name} cannot be reached`, undefined, false);
    return new MeteredSource(this.source.beside(name), this.meter);
  }
}
