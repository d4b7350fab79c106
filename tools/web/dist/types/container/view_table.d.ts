import type { Kernels } from "../kernels/kernels.js";
/** What each chunk of a scene adds to the pictures of some viewpoints (SPEC 5.12). */
export interface ViewTable {
    readonly views: number;
    readonly chunks: number;
    /** Where each viewpoint is, three numbers, in the space of the means. */
    readonly positions: Float32Array;
    /** Where each viewpoint looks, three numbers, about 127 long. */
    readonly directions: Int8Array;
    /** Of each viewpoint the share of the picture that each chunk makes up, viewpoint by viewpoint. */
    readonly shares: Float64Array;
}
/**
 * Read a view table.
 *
 * @param k - Decompresses the codes.
 * @param payload - The segment's bytes; their CRC was checked.
 * @param chunks - Chunks of the whole file.
 * @param allowedBytes - Most bytes of codes.
 */
export declare function readViewTable(k: Kernels, payload: Uint8Array, chunks: number, allowedBytes?: number): ViewTable;
