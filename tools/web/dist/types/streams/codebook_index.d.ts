import type { Kernels } from "../kernels/kernels.js";
import { type StreamRecord } from "./records.js";
/** What a vq stream states of itself (SPEC 6.7). */
export interface IndexParams {
    readonly codebook: number;
    /** Rows that the chunk brings itself, behind those of the codebook. */
    readonly escapes: number;
}
/** Read the parameters of a vq stream. */
export declare function readIndexParams(stream: StreamRecord): IndexParams;
/** Indices below `size` + escapes: a column of u32. */
export declare function readIndices(k: Kernels, stream: StreamRecord, size: number, escapes: number): number;
