import { type Pose, predictPath, type WeightedPose } from "../schedule/poses.js";

/** Age of the pose with which the latest one is compared, seconds (docs/streaming.md, 11). */
const OBSERVED_SECONDS = 0.25;

/** A pose and its time, seconds. */
interface Seen {
  readonly pose: Pose;
  readonly seconds: number;
}

/** Recent poses of a camera. */
export class PoseHistory {
  /** Poses in ascending order of time; all but the first are within the observed time. */
  private readonly seen: Seen[] = [];
  /** Whether a pose was added since the caller reset this. */
  hasChanged = false;
  /** Whether the last predicted path moves. */
  isMoving = false;

  /**
   * Add the latest pose.
   *
   * @param seconds - Time of the pose, on the clock that `path` uses.
   */
  add(pose: Pose, seconds: number): void {
    this.seen.push({ pose, seconds });
    this.hasChanged = true;
  }

  /** Latest pose; undefined before the first. */
  get latest(): Pose | undefined {
    return this.seen.at(-1)?.pose;
  }

  /** Return the latest pose and the poses predicted at a time, seconds; undefined before the first pose. */
  path(seconds: number): WeightedPose[] | undefined {
    const { seen } = this;
    while (seen.length > 1 && seen[1]!.seconds <= seconds - OBSERVED_SECONDS) seen.shift();
    const [before] = seen;
    const now = seen.at(-1);
    if (before === undefined || now === undefined) return undefined;
    this.isMoving = before !== now;
    return predictPath(now.pose, before.pose, seconds - before.seconds);
  }
}
