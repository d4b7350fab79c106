import type { Shifts } from "../container/compensation.js";
import type { ShRows, Splats } from "./splats.js";
import type { TexelArray, Texels, TexelWidth } from "./texels.js";
/** By SH degree. */
export declare const SPARK_WIDTHS: readonly (readonly TexelWidth[])[];
/** Pack rows; `arrays` are as long as `SPARK_WIDTHS` says. */
export declare function packSpark(splats: Splats, arrays: readonly Uint32Array<ArrayBuffer>[]): void;
/** Pack the coefficients above DC of rows, into the textures behind the first two. */
export declare function packSparkBands({ count, shDegree, shN }: ShRows, bands: readonly Uint32Array[]): void;
/** Add shifts of compensation to rows that are in `targets` already. */
export declare function shiftSpark({ arrays, count }: Texels, shifts: Shifts, targets: readonly TexelArray[], first: number): void;
