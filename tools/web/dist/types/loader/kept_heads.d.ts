import type { BandArray, DecodedChunk } from "../workers/decode_task.js";
/**
 * What the heads of chunks were decoded to, until their tails come, which are then decoded alone.
 *
 * Heads are kept as they come until the limit is reached; those beyond it are decoded again with their tails.
 */
export declare class KeptHeads {
    private readonly heads;
    private limit;
    /** Bytes of all that is kept. */
    bytes: number;
    /** Keep no more than so many bytes; the heads that came last, whose tails come last as well, are dropped first. */
    keepAtMost(bytes: number): void;
    /** Keep a copy of a chunk without its coefficients above DC, where there is room; the chunk itself is the caller's. */
    keep(chunk: number, decoded: DecodedChunk): void;
    /** What was kept of a chunk, which is kept no longer. */
    take(chunk: number): DecodedChunk | undefined;
}
/** A chunk of what was kept of it and of its bands. */
export declare function withBands({ splats, packed, texels }: DecodedChunk, bands: readonly BandArray[]): DecodedChunk;
