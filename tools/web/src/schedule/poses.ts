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

/** Seconds ahead that count, and how much. */
const AHEAD = [
  [0, 1],
  [0.5, 0.5],
  [1, 0.25],
] as const;
/** Nobody goes on for longer than so many times the time that was observed. */
const MOST_EXTRAPOLATED = 4;
/** A shorter vector has no direction. */
const SHORTEST = 1e-6;

/** The pose of a visitor who goes on as before: `before` is the pose of `elapsed` seconds ago. */
export function predicted(now: Pose, before: Pose, elapsed: number, ahead: number): Pose {
  if (!(elapsed > 0) || !(ahead > 0)) return now;
  const times = Math.min(ahead / elapsed, MOST_EXTRAPOLATED);
  const goOn = (a: readonly number[], b: readonly number[]): number[] => a.map((x, i) => x + (x - b[i]!) * times);
  const rotation = orthonormal(goOn(now.rotation, before.rotation)) ?? now.rotation;
  return { ...now, position: goOn(now.position, before.position), rotation };
}

/** The pose of now and those soon to come, each with how much it counts. */
export function path(now: Pose, before: Pose, elapsed: number): WeightedPose[] {
  return AHEAD.map(([seconds, weight]) => [predicted(now, before, elapsed, seconds), weight]);
}

/** The rotation of two rows, forward as it is and right across it; undefined where it has none. */
function orthonormal(turned: readonly number[]): number[] | undefined {
  const forward = unit(turned.slice(6));
  if (forward === undefined) return undefined;
  const across = turned.slice(0, 3);
  const along = dot(across, forward);
  const right = unit(across.map((x, i) => x - forward[i]! * along));
  return right && [...right, ...cross(forward, right), ...forward];
}

export function dot(a: readonly number[], b: readonly number[]): number {
  return a[0]! * b[0]! + a[1]! * b[1]! + a[2]! * b[2]!;
}

export function cross(a: readonly number[], b: readonly number[]): number[] {
  return [a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!];
}

function unit(vector: readonly number[]): number[] | undefined {
  const length = Math.sqrt(dot(vector, vector));
  return length > SHORTEST ? vector.map((x) => x / length) : undefined;
}
