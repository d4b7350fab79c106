import type { Kernels } from "../kernels/kernels.js";
import { type StreamRecord } from "./records.js";
/** Quaternions by three of their components (SPEC 6.6): four columns w x y z. */
export declare function readQuats(k: Kernels, stream: StreamRecord): number[];
/**
 * Quaternions as swing and twist (SPEC 6.11): four columns w x y z.
 *
 * @param scales - Columns of the same rows' scales, as the head alone gives them.
 */
export declare function readSwingTwist(k: Kernels, stream: StreamRecord, scales: readonly number[]): number[];
