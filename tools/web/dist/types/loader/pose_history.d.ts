import { type Pose, type WeightedPose } from "../schedule/poses.js";
/** Where a visitor was lately. */
export declare class PoseHistory {
    /** Ascending; none but the first is older than what is looked at. */
    private readonly seen;
    /** Whether a pose has come since this was set to false. */
    hasChanged: boolean;
    /** Whether the path that was asked for last leads somewhere. */
    isMoving: boolean;
    add(pose: Pose, seconds: number): void;
    /** The pose of now; undefined where nobody has looked yet. */
    get latest(): Pose | undefined;
    /** The poses of now and those soon to come; undefined where nobody has looked yet. */
    path(seconds: number): WeightedPose[] | undefined;
}
