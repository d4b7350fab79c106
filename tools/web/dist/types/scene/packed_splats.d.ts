import type { Shifts } from "../container/compensation.js";
import type { Splats } from "./splats.js";
/** Words of a splat in each packed SH band. */
export declare const SH_WORDS: readonly [2, 4, 4];
/**
 * Splats as a renderer uploads them: one texel of four u32 each, but for rotations within the tolerances of SPEC 8.6.
 *
 * This is the layout of Spark's `PackedSplats`, half the size of its other one; any shader can read it. Its rotations are
 * up to 0.034 radians off, coarser than SPEC 8.6 allows; `texels.ts` has layouts that keep all of it.
 *
 * | word | bits | what |
 * |---|---|---|
 * | 0 | 0–7, 8–15, 16–23 | DC colour ½ + 0.282·sh0, R G B, from `rgbMin` to `rgbMax` |
 * | 0 | 24–31 | opacity in 1/255 |
 * | 1 | 0–15, 16–31 | mean x, y, half floats |
 * | 2 | 0–15 | mean z, half float |
 * | 2 | 16–23, 24–31 | axis of the rotation on an octahedron: x, y from −1 to 1 in 255 steps |
 * | 3 | 0–7, 8–15, 16–23 | log scales: −12 + (code − 1)·21/254 |
 * | 3 | 24–31 | angle of the rotation in π/255 |
 *
 * SH bands hold coefficient by coefficient, channels innermost, in two's complement without gaps from bit 0: 9 values
 * of 7 bits in two words, 15 of 8 bits in four, 21 of 6 bits in four.
 */
export interface PackedSplats {
    /** Number of splats. */
    readonly count: number;
    /** Four words a splat. */
    readonly words: Uint32Array;
    /** Packed bands from 1 up to the degree that was asked for; zeros where the coefficients are not there. */
    readonly sh: readonly Uint32Array[];
    readonly ranges: PackRanges;
    /**
     * Of a chunk of a scene with levels that was decoded with the opacities of more than one: these in 1/255 for each splat,
     * level by level from the first that has the chunk on (SPEC 5.11); undefined where a level's have not come.
     */
    readonly opacities?: readonly (Uint8Array | undefined)[];
}
/** What the codes of packed splats stand for. Values outside are clamped. */
export interface PackRanges {
    /** DC colour of byte 0. Trained scenes have colours beyond 0 and 1, which higher bands make up for. */
    readonly rgbMin: number;
    /** DC colour of byte 255. */
    readonly rgbMax: number;
    /** Magnitude of a coefficient above DC that the largest code of a band stands for. */
    readonly shRange: number;
}
/** Ranges that hold nearly all values of trained scenes, in steps within the tolerances of SPEC 8.6. */
export declare const DEFAULT_RANGES: PackRanges;
/** Opacities in 1/255, of their logits. */
export declare function packedOpacities(logits: Float32Array): Uint8Array;
/** The same splats with opacities that are less by a factor, 0 to 1. */
export declare function faded(packed: PackedSplats, factor: number): PackedSplats;
/** The arrays that packed splats stand for, as a shader reads them. */
export declare function unpackSplats(packed: PackedSplats): Splats;
/**
 * Add shifts of compensation (SPEC 8.5) to packed splats.
 *
 * @param words - Packed splats of one chunk, as they were decoded.
 * @param target - Receives the shifted words; may be `words`.
 * @param first - Word of `target` where the chunk begins.
 */
export declare function shiftPacked(words: Uint32Array, shifts: Shifts, target: Uint32Array, first: number): void;
/** Means of packed splats as float32, for sorting: three a splat. */
export declare function packedMeans(packed: Pick<PackedSplats, "count" | "words">): Float32Array;
