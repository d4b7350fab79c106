/**
 * Scenes in Spark, splats for three.js: the entry point `cogsplat/spark`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { type AdapterOptions, type AdapterStream } from "./texel_stream.js";
export type { AdapterOptions, AdapterStream } from "./texel_stream.js";
/** What the adapter uses of Spark's `ExtSplats`. */
export interface SparkExtSplats {
    numSplats: number;
    readonly textures: readonly {
        needsUpdate: boolean;
    }[];
    readonly extra: Record<string, unknown>;
    dispose(): void;
}
/** What the adapter uses of Spark's `SplatMesh`. */
export interface SparkMesh {
    numSplats: number;
    readonly quaternion: {
        set(x: number, y: number, z: number, w: number): unknown;
    };
    readonly position: {
        set(x: number, y: number, z: number): unknown;
    };
    updateVersion(): void;
    dispose(): void;
}
/** The two classes of `@sparkjsdev/spark` that the adapter makes objects of. */
export interface SparkModule<M extends SparkMesh> {
    readonly ExtSplats: new (options: {
        extArrays: [Uint32Array, Uint32Array];
        numSplats: number;
        extra: Record<string, unknown>;
    }) => SparkExtSplats;
    readonly SplatMesh: new (options: {
        extSplats: SparkExtSplats;
    }) => M;
}
/** A scene in Spark. */
export interface SparkScene<M extends SparkMesh> extends AdapterStream {
    /** Add it to a three.js scene; it fills as chunks arrive. */
    readonly mesh: M;
}
/** What `drawBySpec` sets of Spark's `SparkRenderer`. */
export interface SparkSettings {
    readonly material: {
        vertexShader: string;
        needsUpdate: boolean;
    };
    preBlurAmount: number;
    blurAmount: number;
    sortRadial: boolean;
    maxStdDev: number;
    minAlpha: number;
    maxPixelRadius: number;
    clipXY: number;
}
/**
 * Have Spark draw by the rules of SPEC 8.7: sorted by depth, with the scene's kernel, every splat to where it adds 1/255.
 *
 * Call it before the first picture. A renderer has one kernel for all of its scenes. In a version of Spark whose shader is
 * not known, splats that are centred far beside the picture are left out instead, because they would fill it.
 *
 * @param renderer - A `SparkRenderer`, made with `accumExtSplats: true`.
 * @returns Whether all rules are kept.
 *
 * @example
 * ```ts
 * const renderer = new spark.SparkRenderer({ renderer: webgl, accumExtSplats: true });
 * drawBySpec(renderer, scene);
 * world.add(renderer);
 * ```
 */
export declare function drawBySpec(renderer: SparkSettings, { info }: Pick<StreamedScene, "info">): boolean;
/**
 * Stream a scene into a mesh of Spark (three.js).
 *
 * The mesh can be added to a three.js scene at once; splats appear as chunks arrive, and get their view-dependent
 * colour and finer values in place. Rows that have not come are fully transparent; those that are there make up for
 * them (SPEC 8.5) unless `compensate` is false.
 *
 * The splats keep SPEC 8.6 as they are uploaded, in Spark's `ExtSplats`. Spark packs all splats of a picture once more
 * before it draws them, coarser unless its renderer is made with `accumExtSplats`.
 *
 * @param spark - The module `@sparkjsdev/spark`, 2.1 or later.
 *
 * @example
 * ```ts
 * import * as spark from "@sparkjsdev/spark";
 * import { StreamedScene } from "cogsplat";
 * import { streamToSpark } from "cogsplat/spark";
 *
 * world.add(new spark.SparkRenderer({ renderer, accumExtSplats: true }));
 * const { mesh, done } = streamToSpark(await StreamedScene.open(url), spark);
 * world.add(mesh);
 * await done;
 * ```
 */
export declare function streamToSpark<M extends SparkMesh>(scene: StreamedScene, spark: SparkModule<M>, options?: AdapterOptions): SparkScene<M>;
