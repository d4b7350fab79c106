import type { StreamOptions } from "../loader/stream_options.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
/** What the adapter uses of Spark's `PackedSplats`. */
export interface SparkPackedSplats {
    numSplats: number;
    needsUpdate: boolean;
    readonly extra: Record<string, unknown>;
    ensureSplats(count: number): Uint32Array;
    ensureSplatsSh(level: number, count: number): Uint32Array;
}
/** What the adapter uses of Spark's `SplatMesh`. */
export interface SparkMesh {
    numSplats: number;
    readonly quaternion: {
        set(x: number, y: number, z: number, w: number): unknown;
    };
    updateVersion(): void;
}
/** The two classes of `@sparkjsdev/spark` that the adapter makes objects of. */
export interface SparkModule<M extends SparkMesh> {
    readonly PackedSplats: new (options: {
        maxSplats: number;
        splatEncoding: {
            rgbMin: number;
            rgbMax: number;
            sh1Max: number;
            sh2Max: number;
            sh3Max: number;
        };
    }) => SparkPackedSplats;
    readonly SplatMesh: new (options: {
        packedSplats: SparkPackedSplats;
    }) => M;
}
/** How a scene is streamed into Spark. */
export interface SparkOptions extends Omit<StreamOptions, "format"> {
    /** Shortest time between two uploads, ms: Spark uploads whole textures. 250 by default. */
    readonly uploadInterval?: number;
    /** Told after every upload how many splats there are. */
    readonly onUpload?: (splats: number) => void;
}
/**
 * Stream a scene into a mesh of Spark (three.js).
 *
 * The mesh can be added to a three.js scene at once; splats appear as chunks arrive, and get their view-dependent
 * colour and finer values in place. Rows that have not come are fully transparent; those that are there make up for
 * them (SPEC 8.5) unless `compensate` is false.
 *
 * @param spark - The module `@sparkjsdev/spark`, 2.1 or later.
 * @returns The mesh, and a promise that is kept when everything has been uploaded.
 *
 * @example
 * ```ts
 * import * as spark from "@sparkjsdev/spark";
 * const { mesh, done } = streamToSpark(await StreamedScene.open(url), spark);
 * world.add(mesh);
 * await done;
 * ```
 */
export declare function streamToSpark<M extends SparkMesh>(scene: StreamedScene, spark: SparkModule<M>, options?: SparkOptions): {
    readonly mesh: M;
    readonly done: Promise<void>;
};
