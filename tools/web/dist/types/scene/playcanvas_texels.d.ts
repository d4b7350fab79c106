import type { Shifts } from "../container/compensation.js";
import type { Splats } from "./splats.js";
import type { TexelArray, Texels, TexelWidth } from "./texels.js";
/** By SH degree. */
export declare const PLAYCANVAS_WIDTHS: readonly (readonly TexelWidth[])[];
/** Pack rows; `arrays` are as long as `PLAYCANVAS_WIDTHS` says. */
export declare function packPlayCanvas(splats: Splats, arrays: readonly TexelArray[]): void;
/** Add shifts of compensation to rows that are in `targets` already. */
export declare function shiftPlayCanvas({ arrays, count }: Texels, shifts: Shifts, targets: readonly TexelArray[], first: number): void;
