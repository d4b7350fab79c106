import type { Shifts } from "../container/compensation.js";
import type { ShRows, Splats } from "./splats.js";
import type { TexelArray, Texels, TexelWidth } from "./texels.js";
/** By SH degree. */
export declare const PLAYCANVAS_WIDTHS: readonly (readonly TexelWidth[])[];
/** Pack rows; `arrays` are as long as `PLAYCANVAS_WIDTHS` says. */
export declare function packPlayCanvas(splats: Splats, arrays: readonly TexelArray[]): void;
/**
 * Pack the coefficients above DC of rows, into the textures behind the first three: each row's coefficients of its
 * largest magnitude, which stands in the first word.
 */
export declare function packPlayCanvasBands({ count, shN, shDegree }: ShRows, bands: readonly Uint32Array[]): void;
/** Add shifts of compensation to rows that are in `targets` already. */
export declare function shiftPlayCanvas({ arrays, count }: Texels, shifts: Shifts, targets: readonly TexelArray[], first: number): void;
