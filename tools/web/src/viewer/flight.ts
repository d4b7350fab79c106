import type { Vector } from "./orbit.js";
import type { Motion } from "./scene_camera.js";
import type { ViewerPose } from "./viewer_handle.js";

/** Rotation as w, x, y, z. */
export type Quaternion = [number, number, number, number];

/** Duration of a flight, s. */
const SECONDS = 0.9;

/** Return a motion from one pose to another: at once where the system asks for reduced motion. */
export function flight(from: ViewerPose, to: ViewerPose): Motion {
  const duration = matchMedia("(prefers-reduced-motion: reduce)").matches ? 0 : SECONDS;
  let time = 0;
  return (camera, seconds) => {
    time += seconds;
    if (time >= duration) {
      camera.setPose(to);
      return false;
    }
    const share = time / duration;
    camera.setPose(between(from, to, share * share * (3 - 2 * share)));
    return true;
  };
}

/** One end of a flight: the target, its distance, and its direction as the camera sees it. */
interface End {
  readonly target: readonly number[];
  readonly far: number;
  readonly direction: readonly number[];
}

/** Return the pose between two: the direction of view turns, the target moves and its distance grows evenly. */
export function between(from: ViewerPose, to: ViewerPose, share: number): ViewerPose {
  const rotation = matrixOf(slerp(quaternionOf(from.rotation), quaternionOf(to.rotation), share));
  const [a, b] = [from, to].map((pose): End => {
    const position = positionOf(pose);
    const target = pose.target ?? aheadOf(pose, position, 1);
    const far = distance(position, target);
    // Direction of the target as the camera sees it: right, down, forward.
    const direction = [0, 3, 6].map((row) =>
      target.reduce((sum, value, i) => sum + (pose.rotation[row + i]! * (value - position[i]!)) / far, 0),
    );
    return { target, far, direction };
  }) as [End, End];
  const far = a.far * (b.far / a.far) ** share;
  const target = mix(a.target, b.target, share);
  const direction = mix(a.direction, b.direction, share);
  const position = target.map(
    (value, i) => value - far * direction.reduce((sum, part, row) => sum + part * rotation[3 * row + i]!, 0),
  );
  const focal = (key: "fx" | "fy"): number => (from[key] / from.height) ** (1 - share) * (to[key] / to.height) ** share;
  return {
    height: 1,
    fx: focal("fx"),
    fy: focal("fy"),
    rotation,
    translation: translationOf(rotation, position),
    target,
  };
}

/** Return the position of a camera. */
export function positionOf({ rotation: r, translation: t }: ViewerPose): Vector {
  return [0, 1, 2].map((i) => -(r[i]! * t[0]! + r[3 + i]! * t[1]! + r[6 + i]! * t[2]!)) as Vector;
}

/** Return the translation of a camera with a rotation at a position. */
export function translationOf(rotation: readonly number[], position: readonly number[]): Vector {
  return [0, 3, 6].map((row) => -position.reduce((sum, value, i) => sum + rotation[row + i]! * value, 0)) as Vector;
}

/** Return the point at a distance in front of a camera. */
export function aheadOf({ rotation }: ViewerPose, position: readonly number[], far: number): Vector {
  return position.map((value, i) => value + far * rotation[6 + i]!) as Vector;
}

/** Return the distance of two points. */
export function distance(a: readonly number[], b: readonly number[]): number {
  return Math.hypot(...a.map((value, i) => value - b[i]!));
}

function mix(a: readonly number[], b: readonly number[], share: number): Vector {
  return a.map((value, i) => value + share * (b[i]! - value)) as Vector;
}

/** Return the unit quaternion of a rotation, row by row (Shepperd). */
export function quaternionOf(r: readonly number[]): Quaternion {
  const [a, b, c, d, e, f, g, h, i] = r as [number, number, number, number, number, number, number, number, number];
  const squares: Quaternion = [1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i];
  const largest = squares.indexOf(Math.max(...squares));
  const columns: readonly Quaternion[] = [
    [squares[0], h - f, c - g, d - b],
    [h - f, squares[1], d + b, c + g],
    [c - g, d + b, squares[2], h + f],
    [d - b, c + g, h + f, squares[3]],
  ];
  const found = columns[largest]!;
  const size = Math.hypot(...found);
  return found.map((value) => value / size) as Quaternion;
}

/** Return the rotation of a unit quaternion, row by row. */
export function matrixOf([w, x, y, z]: Quaternion): number[] {
  return [
    ...[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    ...[2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    ...[2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** Interpolate two rotations on the shorter arc. */
export function slerp(a: Quaternion, b: Quaternion, share: number): Quaternion {
  const dot = a.reduce((sum, value, i) => sum + value * b[i]!, 0);
  const sign = dot < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(Math.abs(dot), 1));
  const [p, q] =
    angle < 1e-4
      ? [1 - share, share]
      : [Math.sin((1 - share) * angle), Math.sin(share * angle)].map((s) => s / Math.sin(angle));
  const sum = a.map((value, i) => p! * value + sign * q! * b[i]!) as Quaternion;
  const size = Math.hypot(...sum);
  return sum.map((value) => value / size) as Quaternion;
}
