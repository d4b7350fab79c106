import type { StreamedScene } from "../loader/streamed_scene.js";
import type { VisitChange } from "../loader/visit.js";
import type { SplatLayer } from "./splat_layer.js";
/** Fills a layer with what a visitor looks at, and empties what makes room for it. */
export declare class VisitedScene {
    private readonly scene;
    private readonly layer;
    private readonly shifted;
    private readonly shown;
    /** Splats that are in memory. */
    splats: number;
    /** Rows of the chunks that are there. */
    private readonly rows;
    /** Undefined where the layer has room for all: each chunk then has the rows that it has in the scene. */
    private readonly slots;
    /** What each chunk's compensation is for: chunks of a prefix, and layers that were known. */
    private readonly compensatedFor;
    private waiting;
    private isStale;
    /** When the pose changed last, by `performance.now`, where chunks were not changed for it yet. */
    private movedAt;
    /**
     * @param layer - May hold fewer rows than the scene has.
     * @param shifted - Chunks that are shown with what they add for missing ones.
     * @param shown - How much more than usual the pose of now shows of each chunk, where somebody looks.
     */
    constructor(scene: StreamedScene, layer: SplatLayer, shifted: Set<number>, shown: () => Float64Array | undefined);
    /** Draw what has come, or draw no longer what is gone. */
    take(change: VisitChange): void;
    /** Look from somewhere else. */
    look(): void;
    /**
     * Change chunks to make up for what is missing, each by what is there of its cell (SPEC 8.5) and what the pose shows
     * of that (docs/streaming.md, 10).
     *
     * @param end - When to stop, by `performance.now`.
     * @returns Whether there is more to do.
     */
    work(end: number): boolean;
    private plan;
    private compensate;
}
