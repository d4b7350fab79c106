import type { Kernels } from "../kernels/kernels.js";
import { type Payload } from "../streams/records.js";
import { type Codebooks } from "./codebooks.js";
/** A head's rows: addresses of columns of f32. */
export interface HeadColumns {
    readonly means: readonly number[];
    /** Natural logarithms. */
    readonly scales: readonly number[];
    /** w x y z, unit length, w ≥ 0. */
    readonly quats: readonly number[];
    /** Logits. */
    readonly opacities: number;
    readonly sh0: readonly number[];
}
/**
 * Decode a head, refined where its refinement is there (SPEC 7.2, 7.4).
 *
 * @param head - The head's streams.
 * @param refinement - The refinement's, where it is there.
 * @param rows - Splats of the chunk.
 * @param needs - Codebooks that the head's segment needs.
 */
export declare function readHead(k: Kernels, head: Payload, refinement: Payload | undefined, rows: number, needs: number, codebooks: Codebooks): HeadColumns;
/**
 * Decode the opacities of a later level (SPEC 7.5).
 *
 * @param payload - The segment's streams.
 * @param before - Address of the opacities that head and refinement give; differences are added to them there.
 * @param rows - Splats of the chunk.
 * @returns Address of the level's opacities.
 */
export declare function readOpacities(k: Kernels, payload: Payload, before: number, rows: number): number;
