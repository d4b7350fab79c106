import type { StreamedScene } from "../loader/streamed_scene.js";
import type { StreamOptions } from "../loader/stream_options.js";
import { type TexelArray, type TexelLayout } from "../scene/texels.js";
/** How a scene is streamed into a renderer. */
export interface AdapterOptions extends Omit<StreamOptions, "format" | "ranges"> {
    /** Shortest time between two uploads, ms, because renderers upload whole textures. 250 by default. */
    readonly uploadInterval?: number;
    /** Told after every upload how many rows may be drawn. */
    readonly onUpload?: (rows: number) => void;
    /**
     * Position in the world that the renderer's own origin stands for, scene units; the scene's origin by default. Scenes
     * with other origins are then placed where they belong beside each other.
     */
    readonly worldOrigin?: readonly number[];
}
/** The arrays of a whole scene, and what uploads them. */
export interface TexelTarget {
    /** As `texelWidths` orders them, for all of the scene's splats. */
    readonly arrays: readonly TexelArray[];
    /** Show what the arrays hold, up to a number of rows. */
    upload(rows: number): void;
}
/** A stream into a renderer. */
export interface AdapterStream {
    /** Kept when everything has been uploaded; broken by what ends the stream, an abort among it. */
    readonly done: Promise<void>;
    /** End the requests and give back what the renderer holds. */
    dispose(): void;
}
/** SH degree that a stream asks for. */
export declare function wantedDegree(scene: StreamedScene, options: AdapterOptions): number;
/**
 * Fill a renderer's arrays as chunks come, and have them uploaded at intervals.
 *
 * Rows that are there make up for those that are not (SPEC 8.5), less with every chunk; refinements and coefficients
 * take the places of the rows that they replace. No more is done at once than fits into a frame.
 */
export declare function streamTexels(scene: StreamedScene, layout: TexelLayout, target: TexelTarget, options: AdapterOptions, signal: AbortSignal): Promise<void>;
/** Arrays for a scene, of a degree. */
export declare function sceneArrays(scene: StreamedScene, layout: TexelLayout, degree: number): TexelArray[];
/** An abort of one's own that follows the caller's. */
export declare function ownAbort(signal: AbortSignal | undefined): AbortController;
/** Where the scene's origin is in a world whose axes are the renderer's. */
export declare function placeOf(scene: StreamedScene, { worldOrigin }: AdapterOptions): [number, number, number];
