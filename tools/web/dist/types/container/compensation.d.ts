import type { ChunkTable } from "./tables.js";
/** One layer of compensation (SPEC 5.9): what the splats of the first `chunks` chunks gain where only these are there. */
export interface CompensationLayer {
    readonly chunks: number;
    /** For each chunk what its log scales gain, in 1/128. */
    readonly scales: Int8Array;
    /** For each chunk what its logits gain, in 1/16. */
    readonly opacities: Int8Array;
    /** For each chunk how much codes count for scales and for opacities, in 1/64. */
    readonly strengths: Uint8Array;
    /** For each code what it adds to the log scales, in 1/128, and to the logit, in 1/16. */
    readonly book: Int8Array;
    /** Codes of the splats of the chunks that the layer before does not have. */
    readonly codes: Uint8Array;
    /** First chunk that the layer before does not have. */
    readonly firstChunk: number;
}
/**
 * Read the next layer.
 *
 * @param payload - The segment's bytes; their CRC was checked.
 * @param chunks - The file's chunks as far as they are known.
 * @param totalChunks - Chunks of the whole file.
 * @param before - The layer before, where there is one.
 * @returns The layer, or undefined where it has chunks whose index is not known yet.
 */
export declare function readLayer(payload: Uint8Array, chunks: ChunkTable, totalChunks: number, before: CompensationLayer | undefined): CompensationLayer | undefined;
/** What is added to each splat of a chunk: to its three log scales, and to its logit. */
export interface Shifts {
    readonly scales: Float32Array;
    readonly opacities: Float32Array;
}
/**
 * Shifts that are added to a chunk's splats where only the first chunks of the file are there (SPEC 8.5).
 *
 * @param layers - Layers whose segments are there, from the first on.
 * @param chunks - The file's chunks as far as they are known.
 * @param scene - Chunks and splats of the whole file.
 * @param prefix - Number of chunks that are there, from the first on.
 * @param chunk - A chunk of them.
 * @returns For each splat what its log scales and its logit gain; undefined where nothing is added.
 */
export declare function shiftsOf(layers: readonly CompensationLayer[], chunks: ChunkTable, scene: {
    readonly chunks: number;
    readonly splats: number;
}, prefix: number, chunk: number): Shifts | undefined;
