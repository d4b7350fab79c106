import type { ByteRange } from "../container/scene_index.js";
import { CogsplatError, SourceError } from "../errors.js";

/** Options of one read. */
export interface ReadOptions {
  readonly signal?: AbortSignal | undefined;
  /** Bypass caches, because they returned damaged bytes. */
  readonly fresh?: boolean;
  /** Fetch priority, for sources that support it. */
  readonly priority?: RequestPriority | undefined;
}

/** An answer: bytes from `offset` on, in parts, as they arrive. */
export interface Answer {
  /** Offset of the first part; 0 where the source sends the whole file instead of the range. */
  readonly offset: number;
  /** Length of the whole file, if the source states it. */
  readonly total: number | undefined;
  /** Whether the source sends the whole file for every range. */
  readonly whole: boolean;
  readonly parts: AsyncIterable<Uint8Array>;
}

/** Maximum number of requests in flight, unless the source knows that more share a connection (SPEC 8.8). */
export const MAX_REQUESTS = 6;

/** A source of bytes, for example a server or a file. */
export interface ByteSource {
  /** Maximum number of requests in flight; `MAX_REQUESTS` by default. */
  readonly mostRequests?: number | undefined;
  /** Read a range; the answer is shorter where the file ends within it. */
  read(range: ByteRange, options?: ReadOptions): Promise<Answer>;
  /** Return the source of a path relative to this one, such as an object of a folder; required only for folders. */
  relative?(name: string): ByteSource;
}

/** Byte source of a File or Blob. */
export class BlobSource implements ByteSource {
  constructor(private readonly blob: Blob) {}

  async read({ offset, length }: ByteRange, options: ReadOptions = {}): Promise<Answer> {
    options.signal?.throwIfAborted();
    const part = this.blob.slice(offset, offset + length);
    return { offset, total: this.blob.size, whole: false, parts: readParts(part.stream(), options.signal) };
  }
}

/** Longest time without progress by default, ms. */
export const LONGEST_PAUSE = 15_000;
/** New bytes of a request that count as progress (docs/reference/network-faults.md). */
export const PROGRESS_BYTES = 16_384;

/**
 * Iterate over the parts of a stream; leaving the loop, or calling `return` before it, cancels the stream.
 *
 * @param longestPause - Longest time without progress, ms. Time in which the caller asks for no part does not count.
 * @param ended - Called once, at the end of the stream, after an error or when it is cancelled.
 */
export function readParts(
  stream: ReadableStream<Uint8Array>,
  signal: AbortSignal | undefined,
  longestPause = Infinity,
  ended: () => void = () => undefined,
): AsyncIterableIterator<Uint8Array> {
  const reader = stream.getReader();
  const finished = { done: true, value: undefined } as const;
  let isOpen = true;
  let count = 0;
  let waited = 0;
  const close = (): void => {
    if (!isOpen) return;
    isOpen = false;
    ended();
    // A stream may take any time to end, and one that has failed rejects.
    reader.cancel().catch(() => undefined);
  };
  return {
    async next() {
      if (!isOpen) return finished;
      try {
        signal?.throwIfAborted();
        const start = performance.now();
        const part = await withinPause(reader.read(), longestPause - waited, () => lateness(longestPause, count));
        if (part.value === undefined) {
          close();
          return finished;
        }
        waited += performance.now() - start;
        count += part.value.length;
        if (count >= PROGRESS_BYTES) count = waited = 0;
        else if (waited >= longestPause) throw lateness(longestPause, count);
        return { done: false, value: part.value };
      } catch (error) {
        close();
        throw signal?.aborted ? signal.reason : asSourceError(error);
      }
    },
    async return() {
      close();
      return finished;
    },
    [Symbol.asyncIterator]() {
      return this;
    },
  };
}

/** Return the length that an answer states; undefined where it states none, or no length. */
export function lengthOf(headers: Headers): number | undefined {
  const length = headers.get("Content-Length") ?? "";
  return /^\d{1,15}$/.test(length) ? Number(length) : undefined;
}

/** Return the error of a peer that has sent `count` bytes in a time, less than progress. */
export function lateness(milliseconds: number, count = 0): SourceError {
  const found = count === 0 ? "no byte for" : `${count} bytes in`;
  return new SourceError(
    `${found} ${milliseconds} ms, expected ${PROGRESS_BYTES} or the end of the answer`,
    undefined,
    true,
  );
}

/** Wait for a promise, at most for a time, ms; a source that stays silent may answer a retry. */
export async function withinPause<T>(work: Promise<T>, longest: number, late: () => SourceError): Promise<T> {
  if (longest === Infinity) return work;
  let timer: ReturnType<typeof setTimeout> | undefined;
  const pause = new Promise<never>((_, reject) => {
    timer = setTimeout(() => reject(late()), Math.max(longest, 0));
  });
  try {
    return await Promise.race([work, pause]);
  } finally {
    clearTimeout(timer);
  }
}

/** Return an error of the loader for whatever a source has thrown; `fetch` and its bodies throw many types. */
export function asSourceError(error: unknown): SourceError | CogsplatError {
  if (error instanceof SourceError || error instanceof CogsplatError) return error;
  // Bodies throw a TypeError when a connection breaks, in browsers and in Node.
  return new SourceError(`the source failed: ${String(error)}`, undefined, error instanceof TypeError);
}

/** Collects a known number of bytes in memory that grows with the bytes received, not with the number stated. */
export class GrowingBytes {
  private bytes = new Uint8Array(0);
  /** Bytes received. */
  length = 0;

  /** @param expected - Number of bytes expected; more are not accepted. */
  constructor(private readonly expected: number) {}

  get isComplete(): boolean {
    return this.length >= this.expected;
  }

  /** Append a part; all of it must be expected. */
  push(part: Uint8Array): void {
    const end = this.length + part.length;
    if (end > this.bytes.length) {
      const grown = new Uint8Array(Math.min(this.expected, Math.max(end, 2 * this.length, PROGRESS_BYTES)));
      grown.set(this.bytes.subarray(0, this.length));
      this.bytes = grown;
    }
    this.bytes.set(part, this.length);
    this.length = end;
  }

  /** Return the bytes received, without a copy once all have been. */
  take(): Uint8Array {
    return this.bytes.subarray(0, this.length);
  }
}

/** Read all bytes of a range. */
export async function readAll(source: ByteSource, range: ByteRange, options?: ReadOptions): Promise<Uint8Array> {
  const answer = await source.read(range, options);
  const bytes = new GrowingBytes(range.length);
  let skip = skippedBytes(answer, range.offset);
  for await (const part of answer.parts) {
    bytes.push(usefulPart(part, skip, range.length - bytes.length));
    skip = Math.max(0, skip - part.length);
    if (bytes.isComplete) return bytes.take();
  }
  if (bytes.isComplete) return bytes.take();
  throw new SourceError(`${bytes.length} bytes from byte ${range.offset}, expected ${range.length}`, undefined, true);
}

/**
 * Return the bytes of a part that a request needs.
 *
 * @param skip - Bytes before the first one needed, from the beginning of the part on.
 * @param missing - Number of bytes still missing.
 */
export function usefulPart(part: Uint8Array, skip: number, missing: number): Uint8Array {
  return part.subarray(Math.min(skip, part.length), Math.min(part.length, skip + Math.max(0, missing)));
}

/** Return the number of bytes of an answer before a position; an answer from beyond it is refused. */
export function skippedBytes(answer: Answer, position: number): number {
  const skip = position - answer.offset;
  if (!(skip >= 0)) throw new SourceError(`an answer from byte ${answer.offset}, expected byte ${position}`);
  return skip;
}
