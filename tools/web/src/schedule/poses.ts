/** Pose and field of view of a camera (docs/streaming.md, 2). */
export interface Pose {
  /** Position in the space of the means. */
  readonly position: readonly number[];
  /** World to camera, row by row: right, down, forward. */
  readonly rotation: readonly number[];
  /** Half of the picture's width and height at a distance of 1. */
  readonly tanX: number;
  readonly tanY: number;
}

/** A pose and its weight. */
export type WeightedPose = readonly [Pose, number];

/** Prediction times, seconds ahead, and their weights. */
const AHEAD = [
  [0, 1],
  [0.5, 0.5],
  [1, 0.25],
] as const;
/** Largest ratio of the prediction time to the time observed. */
const MOST_EXTRAPOLATED = 4;
/** Length below which a vector has no direction. */
const SHORTEST = 1e-6;

/**
 * Extrapolate the motion of a camera.
 *
 * @param now - Latest pose.
 * @param before - Pose `elapsed` seconds ago.
 * @param elapsed - Time between the two poses, seconds.
 * @param ahead - Prediction time, seconds.
 */
export function predictPose(now: Pose, before: Pose, elapsed: number, ahead: number): Pose {
  if (!(elapsed > 0) || !(ahead > 0)) return now;
  const times = Math.min(ahead / elapsed, MOST_EXTRAPOLATED);
  const goOn = (a: readonly number[], b: readonly number[]): number[] => a.map((x, i) => x + (x - b[i]!) * times);
  const rotation = orthonormal(goOn(now.rotation, before.rotation)) ?? now.rotation;
  return { ...now, position: goOn(now.position, before.position), rotation };
}

/** Return the latest pose and the predicted ones, each with its weight. */
export function predictPath(now: Pose, before: Pose, elapsed: number): WeightedPose[] {
  return AHEAD.map(([seconds, weight]) => [predictPose(now, before, elapsed, seconds), weight]);
}

/** Orthonormalise a rotation, keeping its forward direction; undefined for a degenerate one. */
function orthonormal(turned: readonly number[]): number[] | undefined {
  const forward = unit(turned.slice(6));
  if (forward === undefined) return undefined;
  const across = turned.slice(0, 3);
  const along = dot(across, forward);
  const right = unit(across.map((x, i) => x - forward[i]! * along));
  return right && [...right, ...cross(forward, right), ...forward];
}

function dot(a: readonly number[], b: readonly number[]): number {
  return a[0]! * b[0]! + a[1]! * b[1]! + a[2]! * b[2]!;
}

function cross(a: readonly number[], b: readonly number[]): number[] {
  return [a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!];
}

function unit(vector: readonly number[]): number[] | undefined {
  const length = Math.sqrt(dot(vector, vector));
  return length > SHORTEST ? vector.map((x) => x / length) : undefined;
}
