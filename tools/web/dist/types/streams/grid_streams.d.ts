import type { Kernels } from "../kernels/kernels.js";
import { type StreamRecord } from "./records.js";
/**
 * Values of a stream of codes on grids: scalar, differences, or basis of sh0 (SPEC 6.4, 6.12, 6.13).
 *
 * @param stream - The stream.
 * @param refinement - The digits that a refinement adds (SPEC 6.16), where there are any.
 * @returns For each component the address of a column of f32.
 */
export declare function readGridStream(k: Kernels, stream: StreamRecord, refinement?: StreamRecord): number[];
/**
 * Rows of a scalar stream whose components stand together, as SH bands do.
 *
 * @param target - Address of `rows` rows of as many f32 as the stream has components.
 */
export declare function readScalarRows(k: Kernels, stream: StreamRecord, target: number): void;
