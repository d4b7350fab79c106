import type { Kernels } from "../kernels/kernels.js";
import { type StoredPlane } from "./planes.js";
/** Bytes of a grid entry (SPEC 6.4). */
export declare const GRID_BYTES = 12;
/** A uniform grid of one component (SPEC 6.4). */
export interface Grid {
    readonly minimum: number;
    readonly levels: number;
    /** Distance of two levels, float32; 0 where there is one level. */
    readonly step: number;
}
/**
 * Read and check grid entries: all ranges, then all levels (SPEC 7.6).
 *
 * @param params - Parameters of a stream.
 * @param at - Byte where the first entry begins.
 * @param count - Number of entries.
 * @param maxLevels - Most levels; 2^24, less where the kind says so.
 * @param maxEnd - Largest magnitude of minimum and maximum.
 */
export declare function readGrids(params: DataView, at: number, count: number, maxLevels?: number, maxEnd?: number): Grid[];
/** Byte planes that codes below `limit` take (SPEC 6.4). */
export declare function planesOf(limit: number): number;
/**
 * Codes of consecutive byte planes, the lowest byte first.
 *
 * @param planes - Up to three planes.
 * @param rows - Codes to read.
 * @param limit - Codes MUST be below it.
 * @param reason - Code of the refusal where one is not.
 * @returns Address of a column of u32.
 */
export declare function readCodes(k: Kernels, planes: readonly StoredPlane[], rows: number, limit: number, reason?: "code-range" | "index-range"): number;
