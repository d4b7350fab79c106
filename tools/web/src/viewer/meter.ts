import type { ByteRange } from "../container/scene_index.js";
import { SourceError } from "../errors.js";
import type { Answer, ByteSource, ReadOptions } from "../loader/byte_source.js";

/** Counts received bytes, and limits their rate if one is set. */
export class Meter {
  /** Number of bytes received. */
  bytes = 0;
  /** Time of the first byte, from `performance.now`. */
  since: number | undefined;
  /** Maximum bandwidth, bit/s. */
  bitsPerSecond = Infinity;
  /** Time at which all bytes so far would have arrived at the rate, ms. */
  private due = 0;

  /** Reset the count. */
  reset(): void {
    this.bytes = 0;
    this.since = undefined;
  }

  /** Count and delay parts. */
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

/** A source whose bytes pass through a meter. */
export class MeteredSource implements ByteSource {
  constructor(
    private readonly source: ByteSource,
    private readonly meter: Meter,
  ) {}

  async read(range: ByteRange, options?: ReadOptions): Promise<Answer> {
    const answer = await this.source.read(range, options);
    return { ...answer, parts: this.meter.through(answer.parts) };
  }

  relative(name: string): ByteSource {
    if (this.source.relative === undefined) throw new SourceError(`${name} cannot be reached`, undefined, false);
    return new MeteredSource(this.source.relative(name), this.meter);
  }
}
