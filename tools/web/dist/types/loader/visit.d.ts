import type { Pose } from "../schedule/poses.js";
import { type ChunkUpdate, type StreamOptions } from "./stream_options.js";
import type { StreamedScene } from "./streamed_scene.js";
export { along, byBoxes, bySgss, byViewTable, countedSplats, type PoseRatios } from "../schedule/chunk_ratios.js";
export { path, predicted, type Pose, type WeightedPose } from "../schedule/poses.js";
export { Scheduler, type Decision, type Holdings, type Unit } from "../schedule/scheduler.js";
/** How a scene is visited; what `splatBudget` or `memoryBudget` have no room for is fetched when it is looked at, in the place of other things. */
export interface VisitOptions extends Pick<StreamOptions, "signal" | "degree" | "format" | "ranges" | "memoryBudget" | "splatBudget" | "compensate" | "onDamage"> {
    /** Told when all that the pose is worth is there, and when something is missing again. */
    readonly onSettled?: (isSettled: boolean) => void;
}
/** A chunk that has come, for the first time or with more, behind its parent (SPEC 5.4); or one that was thrown away. */
export type VisitChange = ({
    readonly kind: "rows";
} & Omit<ChunkUpdate, "prefix">) | {
    readonly kind: "gone";
    readonly chunk: number;
};
/**
 * A visitor in a scene: what the pose and the next second of its path show is fetched first, and in a scene that is larger
 * than its budget the rest makes room for it (docs/streaming.md).
 */
export declare class Visit {
    private readonly source;
    private readonly service;
    private readonly options;
    private readonly index;
    private readonly requests;
    private readonly queue;
    private readonly poses;
    private readonly degree;
    private budget;
    private units;
    private unitsOf;
    private scheduler;
    private parents;
    private readonly there;
    /** Units that come otherwise than by a request that can be stopped: from the first bytes, or once more around caches. */
    private readonly aside;
    /** Chunks of which rows were given, and rows that wait for those of their parent. */
    private readonly given;
    private readonly early;
    /** Chunks that cannot be had; nothing waits for them. */
    private readonly lost;
    private readonly waiting;
    private table;
    private rule;
    private ratios;
    private ratiosAt;
    private timer;
    private isTurning;
    private settled;
    private isOver;
    private failure;
    private wake;
    /**
     * Begin to visit a scene.
     *
     * @throws SourceError where the server gives the whole file whatever it is asked for.
     *
     * @example
     * ```ts
     * const visit = await Visit.begin(scene, { format: "packed", splatBudget: 2_000_000 });
     * visit.look(camera.pose); // again whenever it moves
     * for await (const change of visit.changes()) {
     *   if (change.kind === "rows") draw(change);
     *   else remove(change.chunk);
     * }
     * ```
     */
    static begin(scene: StreamedScene, options?: VisitOptions): Promise<Visit>;
    private constructor();
    /** Look from somewhere: what is fetched follows, and where the path goes on to. */
    look(pose: Pose): void;
    /** How much more than usual the pose of now shows of each chunk (docs/streaming.md, 4 and 5); undefined before the first look. */
    shown(): Float64Array | undefined;
    /** Hold at most so many splats from now on. */
    limit(splats: number): void;
    /**
     * What comes and goes; it ends when all of the scene is there, else with the signal or when it is left.
     */
    changes(): AsyncGenerator<VisitChange, void, undefined>;
    private get isWhole();
    /** Read the index pages, one after the other; their segments can be chosen as they come. */
    private readPages;
    private enterUnits;
    private fail;
    /** Decide when what happens now has happened. */
    private turnSoon;
    private turn;
    private settle;
    private holdings;
    /** Ratios of the poses to come, made anew when these have changed, and some time has passed. */
    private currentRatios;
    private makeRule;
    private fetch;
    /** Take a unit that the first request has brought or brings. */
    private fromBeginning;
    /** Take a unit; what is damaged is asked for once more, around caches. */
    private came;
    private fetchAgain;
    private take;
    private useTable;
    /** Go on without units that cannot be had, or end where no others would come either. */
    private lose;
    /** Wait for a chunk no more. */
    private forgo;
    /** Report what cannot be had; without a listener the visit ends with the error. */
    private damage;
    /** Give rows to the caller, behind those of the chunk's parent; those of a chunk that was thrown away are left. */
    private give;
    private isHeld;
    /** Throw a chunk away. */
    private evict;
}
