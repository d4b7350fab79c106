import type { ByteRange } from "../container/scene_index.js";
import { SourceError } from "../errors.js";

/** What a source is asked for. */
export interface ReadOptions {
  readonly signal?: AbortSignal | undefined;
  /** Go around caches, because what they gave was damaged. */
  readonly fresh?: boolean;
  /** How soon it is wanted beside other requests, where the source can tell others. */
  readonly priority?: RequestPriority | undefined;
}

/** An answer: bytes from `offset` on, in parts, as they arrive. */
export interface Answer {
  /** First byte of the parts; 0 where the source gives the whole file instead of the range. */
  readonly offset: number;
  /** Length of the whole file, where the source says so. */
  readonly total: number | undefined;
  /** Whether the source gives the whole file whatever range it is asked for. */
  readonly whole: boolean;
  readonly parts: AsyncIterable<Uint8Array>;
}

/** Where bytes come from. */
export interface ByteSource {
  /** Ask for a range; fewer bytes come where the file ends in it. */
  read(range: ByteRange, options?: ReadOptions): Promise<Answer>;
  /** What is named relative to this source, as the objects of a folder are to its manifest; without it no folder is read. */
  beside?(name: string): ByteSource;
}

/** A File or Blob. */
export class BlobSource implements ByteSource {
  constructor(private readonly blob: Blob) {}

  async read({ offset, length }: ByteRange, options: ReadOptions = {}): Promise<Answer> {
    options.signal?.throwIfAborted();
    const part = this.blob.slice(offset, offset + length);
    return { offset, total: this.blob.size, whole: false, parts: readParts(part.stream(), options.signal) };
  }
}

/**
 * The parts of a stream; the stream is cancelled where nobody reads on.
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
          open = false; // A stream that fails while it is read has ended.
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

/** Wait for something, but no longer than a pause, ms; a source that says nothing may answer when it is asked again. */
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

/** All bytes of a range. */
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
      `${Math.max(at, 0)} bytes in the place of ${range.length} from byte ${range.offset}`,
      undefined,
      true,
    );
  }
  return bytes;
}
