import type { ByteRange } from "../container/scene_index.js";
import { SourceError } from "../errors.js";

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

/** A source of bytes, for example a server or a file. */
export interface ByteSource {
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

/**
 * Iterate over the parts of a stream; leaving the loop cancels the stream.
 *
 * @param longestPause - Longest time without a byte, ms.
 */
export async function* readParts(
  stream: ReadableStream<Uint8Array>,
  signal: AbortSignal | undefined,
  longestPause = Infinity,
): AsyncGenerator<Uint8Array> {
  const reader = stream.getReader();
  let open = true;
  try {
    for (;;) {
      signal?.throwIfAborted();
      const part = await withinPause(
        reader.read().catch((error: unknown) => {
          open = false; // A failed stream needs no cancelling.
          throw error;
        }),
        longestPause,
      );
      open = !part.done;
      if (part.value === undefined) return;
      yield part.value;
    }
  } finally {
    if (open) await reader.cancel();
  }
}

/** Return the result of a promise; throw a retryable error if it takes longer than a pause, ms. */
export async function withinPause<T>(work: Promise<T>, longestPause: number): Promise<T> {
  if (longestPause === Infinity) return work;
  let timer: ReturnType<typeof setTimeout> | undefined;
  const pause = new Promise<never>((_, reject) => {
    timer = setTimeout(() => reject(new SourceError(`no byte for ${longestPause} ms`, undefined, true)), longestPause);
  });
  try {
    return await Promise.race([work, pause]);
  } finally {
    clearTimeout(timer);
  }
}

/** Read all bytes of a range. */
export async function readAll(source: ByteSource, range: ByteRange, options?: ReadOptions): Promise<Uint8Array> {
  const answer = await source.read(range, options);
  const bytes = new Uint8Array(range.length);
  let at = answer.offset - range.offset;
  for await (const part of answer.parts) {
    const from = Math.max(0, -at);
    const room = range.length - Math.max(at, 0);
    if (from < part.length && room > 0) bytes.set(part.subarray(from, Math.min(part.length, from + room)), at + from);
    at += part.length;
    if (at >= range.length) break;
  }
  if (at < range.length) {
    throw new SourceError(
      `${Math.max(at, 0)} bytes from byte ${range.offset}, expected ${range.length}`,
      undefined,
      true,
    );
  }
  return bytes;
}
