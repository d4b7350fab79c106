import { type Pose, path, type WeightedPose } from "../schedule/poses.js";

/** How long ago the pose was that shows where a visitor goes, seconds (docs/streaming.md, 11). */
const OBSERVED_SECONDS = 0.25;

interface Seen {
  readonly pose: Pose;
  readonly seconds: number;
}

/** Where a visitor was lately. */
export class PoseHistory {
  /** Ascending; none but the first is older than what is looked at. */
  private readonly seen: Seen[] = [];
  /** Whether a pose has come since this was set to false. */
  hasChanged = false;
  /** Whether the path that was asked for last leads somewhere. */
  isMoving = false;

  add(pose: Pose, seconds: number): void {
    this.seen.push({ pose, seconds });
    this.hasChanged = true;
  }

  /** The pose of now; undefined where nobody has looked yet. */
  get latest(): Pose | undefined {
    return this.seen.at(-1)?.pose;
  }

  /** The poses of now and those soon to come; undefined where nobody has looked yet. */
  path(seconds: number): WeightedPose[] | undefined {
    const { seen } = this;
    while (seen.length > 1 && seen[1]!.seconds <= seconds - OBSERVED_SECONDS) seen.shift();
    const [before] = seen;
    const now = seen.at(-1);
    if (before === undefined || now === undefined) return undefined;
    this.isMoving = before !== now;
    return path(now.pose, before.pose, seconds - before.seconds);
  }
}
