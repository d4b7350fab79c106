import type { ByteRange } from "../container/scene_index.js";
import { SourceError } from "../errors.js";
import { type Answer, type ByteSource, readAll } from "./byte_source.js";
import { backOff, isRetryable, type RetryOptions, requestedWait } from "./retry.js";

/** Reader of ranges that retries failed requests after a pause, from the first missing byte. */
export class RetryingReader {
  constructor(
    private readonly source: ByteSource,
    private readonly retry: RetryOptions,
  ) {}

  /**
   * Read a range that may extend beyond the end of the file.
   *
   * @param receiver - `begin` receives each answer, `take` the parts in order, without gaps.
   */
  async readBeginning(
    range: ByteRange,
    signal: AbortSignal,
    receiver: { readonly begin: (answer: Answer) => void; readonly take: (part: Uint8Array) => void },
  ): Promise<void> {
    let received = 0;
    await this.attempt(
      signal,
      async () => {
        const at = range.offset + received;
        const answer = await this.source.read({ offset: at, length: range.length - received }, { signal });
        receiver.begin(answer);
        const { total } = answer;
        const expected = Math.min(range.length, (total ?? Infinity) - range.offset);
        let skip = at - answer.offset;
        for await (const part of answer.parts) {
          const used = part.subarray(Math.min(skip, part.length), Math.min(part.length, skip + expected - received));
          skip -= Math.min(skip, part.length);
          received += used.length;
          if (used.length > 0) receiver.take(used);
          if (received >= expected) return;
        }
        if (total !== undefined && received < expected) {
          throw new SourceError(`${received} bytes from byte ${range.offset}, expected ${expected}`, undefined, true);
        }
      },
      () => received,
    );
  }

  /** Read all bytes of a range. */
  async readAll(range: ByteRange, signal: AbortSignal | undefined, fresh = false): Promise<Uint8Array> {
    return this.attempt(signal, () => readAll(this.source, range, { signal, fresh }));
  }

  /**
   * Read a range part by part.
   *
   * @param take - Receives the parts in order, without gaps.
   * @param priority - Priority among other requests.
   */
  async readParts(
    range: ByteRange,
    signal: AbortSignal,
    take: (part: Uint8Array) => void,
    priority?: RequestPriority,
  ): Promise<void> {
    let received = 0;
    await this.attempt(
      signal,
      async () => {
        const rest = { offset: range.offset + received, length: range.length - received };
        const answer = await this.source.read(rest, { signal, priority });
        let skip = rest.offset - answer.offset;
        for await (const part of answer.parts) {
          const useful = part.subarray(
            Math.min(skip, part.length),
            Math.min(part.length, skip + range.length - received),
          );
          skip -= Math.min(skip, part.length);
          received += useful.length;
          if (useful.length > 0) take(useful);
          if (received === range.length) return;
        }
        throw new SourceError(`${received} bytes from byte ${range.offset}, expected ${range.length}`, undefined, true);
      },
      () => received,
    );
  }

  /** @param received - Number of bytes so far; an attempt that brought some resets the count of retries. */
  private async attempt<T>(
    signal: AbortSignal | undefined,
    work: () => Promise<T>,
    received = (): number => 0,
  ): Promise<T> {
    let had = 0;
    for (let attempt = 1; ; attempt++) {
      try {
        return await work();
      } catch (error) {
        if (received() > had) [had, attempt] = [received(), 1];
        const asked = requestedWait(error);
        const isLast = attempt > this.retry.retries || asked > this.retry.longestWait;
        if (signal?.aborted || isLast || !isRetryable(error)) throw error;
        await backOff(attempt, this.retry, signal, asked);
      }
    }
  }
}
