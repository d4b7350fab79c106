import type { ByteRange } from "../container/scene_index.js";
import { SourceError } from "../errors.js";
import {
  type Answer,
  asSourceError,
  type ByteSource,
  GrowingBytes,
  MAX_REQUESTS,
  PROGRESS_BYTES,
  type ReadOptions,
  skippedBytes,
  usefulPart,
} from "./byte_source.js";
import { backOff, isRetryable, type RetryOptions, requestedWait } from "./retry.js";

/**
 * Reader of ranges that retries failed requests after a pause, from the first missing byte.
 *
 * It throws errors of the loader alone, whatever the source throws, and after an abort the signal's reason.
 */
export class RetryingReader {
  constructor(
    private readonly source: ByteSource,
    private readonly retry: RetryOptions,
  ) {}

  /** Maximum number of requests in flight. */
  get mostRequests(): number {
    return this.source.mostRequests ?? MAX_REQUESTS;
  }

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
    await this.read(range, { signal }, receiver.take, (answer) => {
      receiver.begin(answer);
      const { total } = answer;
      return total === undefined ? undefined : Math.min(range.length, total - range.offset);
    });
  }

  /** Read all bytes of a range. */
  async readAll(range: ByteRange, signal: AbortSignal | undefined, fresh = false): Promise<Uint8Array> {
    const bytes = new GrowingBytes(range.length);
    await this.read(range, { signal, fresh }, (part) => bytes.push(part));
    return bytes.take();
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
    await this.read(range, { signal, priority }, take);
  }

  /**
   * Read a range, with retries.
   *
   * @param expected - Returns the number of bytes to read, from an answer; undefined where the file may end within the
   *   range.
   */
  private async read(
    range: ByteRange,
    options: ReadOptions,
    take: (part: Uint8Array) => void,
    expected: (answer: Answer) => number | undefined = () => range.length,
  ): Promise<void> {
    const { signal } = options;
    let received = 0;
    // Attempts in a row that failed, and the bytes received when the last progress was complete.
    let failed = 0;
    let progress = 0;
    for (;;) {
      try {
        const rest = { offset: range.offset + received, length: range.length - received };
        const answer = await this.source.read(rest, options);
        const length = expected(answer);
        let skip = skippedBytes(answer, rest.offset);
        for await (const part of answer.parts) {
          const useful = usefulPart(part, skip, (length ?? range.length) - received);
          skip = Math.max(0, skip - part.length);
          received += useful.length;
          if (useful.length > 0) take(useful);
          if (received >= (length ?? range.length)) return;
        }
        if (length === undefined || received >= length) return;
        throw new SourceError(`${received} bytes from byte ${range.offset}, expected ${length}`, undefined, true);
      } catch (thrown) {
        if (signal?.aborted) throw signal.reason;
        const error = asSourceError(thrown);
        if (received - progress >= PROGRESS_BYTES) [failed, progress] = [0, received];
        failed++;
        const asked = requestedWait(error);
        if (failed > this.retry.retries || asked > this.retry.longestWait || !isRetryable(error)) throw error;
        await backOff(failed, this.retry, signal, asked);
      }
    }
  }
}
