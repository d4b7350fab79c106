import type { SceneIndex } from "../container/scene_index.js";
import type { ViewTable } from "../container/view_table.js";
import { type Pose } from "../schedule/poses.js";
import type { SegmentOrder } from "./stream_options.js";
export { along, byBoxes, bySgss, byViewTable, type PoseRatios } from "../schedule/chunk_ratios.js";
export { path, predicted, type Pose, type WeightedPose } from "../schedule/poses.js";
export { Scheduler, type Decision, type Holdings, type Unit } from "../schedule/scheduler.js";
/** What is taken from an index. */
type Index = Pick<SceneIndex, "segments" | "chunks" | "complete" | "range" | "codebookSegmentsOf">;
/**
 * The option `order` of a stream for a visitor: what the pose and the next second of the path show comes first.
 *
 * @param pose - Where the visitor is; asked before every request.
 *
 * @example
 * ```ts
 * for await (const update of scene.stream({ order: byView(() => camera.pose) })) draw(update);
 * ```
 */
export declare function byView(pose: () => Pose): (index: SceneIndex) => SegmentOrder;
/** Orders segments by what a visitor sees (docs/streaming.md): by the view table once it is there, by boxes until then. */
export declare class ViewOrder implements SegmentOrder {
    private readonly index;
    private readonly pose;
    private table;
    private ratios;
    /** Chunks that `ratios` knows. */
    private known;
    private last;
    constructor(index: Index, pose: () => Pose);
    useTable(table: ViewTable): void;
    order(segments: readonly number[], seconds: number): number[];
    private units;
    private currentRatios;
}
