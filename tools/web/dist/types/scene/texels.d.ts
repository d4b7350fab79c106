import type { Shifts } from "../container/compensation.js";
import type { ShRows, Splats } from "./splats.js";
/** Whose textures chunks are decoded to: those of Spark's `ExtSplats`, or of PlayCanvas' uncompressed splats. */
export type TexelLayout = "spark" | "playcanvas";
/** An array for one texture of a renderer, some elements a splat. */
export type TexelArray = Uint32Array<ArrayBuffer> | Uint16Array<ArrayBuffer>;
/** Rows of splats as the textures of a renderer hold them. */
export interface Texels {
    readonly count: number;
    readonly layout: TexelLayout;
    readonly arrays: readonly TexelArray[];
}
/** A texture of a layout: what an array of it has for each splat. */
export interface TexelWidth {
    readonly name: string;
    /** Elements of a splat. */
    readonly width: number;
    /** Bytes of an element: 4 for u32, 2 for half floats. */
    readonly bytes: 2 | 4;
}
/** The textures of a layout that an SH degree needs, in the order of the arrays. */
export declare function texelWidths(layout: TexelLayout, degree: number): readonly TexelWidth[];
/** Arrays of a layout for so many splats, all zeros: splats that are not drawn. */
export declare function makeTexelArrays(layout: TexelLayout, degree: number, splats: number): TexelArray[];
/** Pack splats into the textures of a renderer, within the tolerances of SPEC 8.6. */
export declare function packTexels(layout: TexelLayout, splats: Splats): Texels;
/** The textures of a layout that hold no coefficients above DC; they stand first. */
export declare function headTextures(layout: TexelLayout): number;
/** Pack coefficients above DC alone, into the textures behind those that hold none; the degree is above 0. */
export declare function packBandTexels(layout: TexelLayout, rows: ShRows): TexelArray[];
/**
 * Write rows into arrays of a whole scene, with what compensation adds to them (SPEC 8.5).
 *
 * @param shifts - What is added; undefined where nothing is.
 * @param first - Row of the whole scene that the first row is.
 */
export declare function writeTexels(texels: Texels, shifts: Shifts | undefined, targets: readonly TexelArray[], first: number): void;
