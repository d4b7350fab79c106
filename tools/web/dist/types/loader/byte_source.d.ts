import type { ByteRange } from "../container/scene_index.js";
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
export declare class BlobSource implements ByteSource {
    private readonly blob;
    constructor(blob: Blob);
    read({ offset, length }: ByteRange, options?: ReadOptions): Promise<Answer>;
}
/**
 * The parts of a stream; the stream is cancelled where nobody reads on.
 *
 * @param longestPause - Longest time without a byte, ms.
 */
export declare function readParts(stream: ReadableStream<Uint8Array>, signal: AbortSignal | undefined, longestPause?: number): AsyncGenerator<Uint8Array>;
/** Wait for something, but no longer than a pause, ms; a source that says nothing may answer when it is asked again. */
export declare function withinPause<T>(work: Promise<T>, longestPause: number): Promise<T>;
/** All bytes of a range. */
export declare function readAll(source: ByteSource, range: ByteRange, options?: ReadOptions): Promise<Uint8Array>;
