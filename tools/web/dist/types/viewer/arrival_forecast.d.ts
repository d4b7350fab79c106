import type { FeedProgress } from "./scene_feed.js";
/** How far a scene has come; its length where it is known. */
type Arrived = Pick<FeedProgress, "splats" | "totalSplats" | "bytes"> & {
    readonly totalBytes?: number | undefined;
};
/**
 * How long it takes until all of a scene is there, if what is missing comes as fast as what has come; bytes and splats
 * count, because bytes that have come are decoded first. Where nothing more comes it grows with time.
 *
 * @param passed - Since the first bytes, ms.
 * @returns ms; Infinity where it cannot be said.
 */
export declare function millisecondsLeft(progress: Arrived, passed: number): number;
export {};
