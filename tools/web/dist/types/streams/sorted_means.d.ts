import type { Kernels } from "../kernels/kernels.js";
import { type StreamRecord } from "./records.js";
/**
 * Means in Morton order on a coarse grid with extra bits by the step model (SPEC 6.5, 6.15, 6.17).
 *
 * @param scales - Columns of the same rows' scales, as the head alone gives them.
 * @param refinement - The bits stream of a refinement, where there is one.
 * @returns Three columns of f32.
 */
export declare function readSortedMeans(k: Kernels, stream: StreamRecord, scales: readonly number[], refinement?: StreamRecord): number[];
