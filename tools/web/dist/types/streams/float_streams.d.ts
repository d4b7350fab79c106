import type { Kernels } from "../kernels/kernels.js";
import { type StreamRecord } from "./records.js";
/** Columns of a float stream (SPEC 6.8). */
export declare function readFloatStream(k: Kernels, stream: StreamRecord): number[];
/**
 * Rows of a float stream whose components stand together, as SH bands do.
 *
 * @param target - Address of `rows` rows of as many f32 as the stream has components.
 */
export declare function readFloatRows(k: Kernels, stream: StreamRecord, target: number): void;
