import type { Splats } from "../scene/splats.js";
/** How a PLY is written. */
export interface PlyOptions {
    /** Added to every mean: the scene's origin, for positions in the world; zeros by default. */
    readonly origin?: readonly number[];
}
/** The properties of a splat in the PLY of 3DGS training, in their order, for a degree. */
export declare function plyProperties(shDegree: number): string[];
/**
 * Write splats as the binary PLY of 3DGS training.
 *
 * @example
 * ```ts
 * const file = new SceneFile(bytes, (await loadKernels())());
 * const ply = toPly(file.decode(), { origin: file.scene.origin });
 * ```
 */
export declare function toPly(splats: Splats, { origin }?: PlyOptions): Uint8Array;
