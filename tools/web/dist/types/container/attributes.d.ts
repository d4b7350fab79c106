import type { Kernels } from "../kernels/kernels.js";
import { type AttributeEntry } from "./root.js";
/** Values of an extra attribute. */
export type AttributeArray = Uint8Array | Int8Array | Uint16Array | Int16Array | Uint32Array | Int32Array | Float32Array | Float64Array;
/**
 * Read a chunk's extra attributes (SPEC 5.7).
 *
 * @param payload - The segment's bytes; their CRC was checked.
 * @param rows - Splats of the chunk.
 * @returns Values by name, those of a row side by side.
 */
export declare function readAttributes(k: Kernels, payload: Uint8Array, entries: readonly AttributeEntry[], rows: number): Map<string, AttributeArray>;
