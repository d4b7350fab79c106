/** Where a visitor is and what part of space the picture shows (docs/streaming.md, 2). */
export interface Pose {
    /** In the space of the means. */
    readonly position: readonly number[];
    /** World to camera, row by row: right, down, forward. */
    readonly rotation: readonly number[];
    /** Half of the picture's width and height at a distance of 1. */
    readonly tanX: number;
    readonly tanY: number;
}
/** A pose that counts, and how much. */
export type WeightedPose = readonly [Pose, number];
/** The pose of a visitor who goes on as before: `before` is the pose of `elapsed` seconds ago. */
export declare function predicted(now: Pose, before: Pose, elapsed: number, ahead: number): Pose;
/** The pose of now and those soon to come, each with how much it counts. */
export declare function path(now: Pose, before: Pose, elapsed: number): WeightedPose[];
export declare function dot(a: readonly number[], b: readonly number[]): number;
export declare function cross(a: readonly number[], b: readonly number[]): number[];
