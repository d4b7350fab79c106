import type { Kernels } from "../kernels/kernels.js";
/** Bytes of a step model's six coefficients (SPEC 6.10). */
export declare const STEP_MODEL_BYTES = 24;
/**
 * Extra bits of each row by its decoded scales (SPEC 6.10).
 *
 * @param params - Parameters of a stream; the six coefficients begin at byte `at`.
 * @param scales - Three columns.
 * @returns Address of one byte for each row, 0 to 15.
 */
export declare function readExtraBits(k: Kernels, params: DataView, at: number, scales: readonly number[], rows: number): number;
/** How many rows have 0, 1, … 15 extra bits. */
export declare function countExtraBits(k: Kernels, extra: number, rows: number): Uint32Array;
/** A table of addresses or columns in the kernels' memory. */
export declare function addressTable(k: Kernels, addresses: readonly number[]): number;
