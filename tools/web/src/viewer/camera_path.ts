import type { CameraPath } from "../container/description.js";
import { matrixOf, positionOf, quaternionOf, slerp, translationOf } from "./flight.js";
import type { Vector } from "./orbit.js";
import type { Motion } from "./scene_camera.js";
import type { ViewerPose } from "./viewer_handle.js";

/** Return the pose of a path at a time, s: positions on a curve through the stops, directions on the shortest arcs. */
export function poseAt({ stops }: CameraPath, time: number): ViewerPose {
  const after = stops.findIndex((stop) => stop.time > time);
  if (after <= 0) return stops.at(after)!;
  const [a, b] = [stops[after - 1]!, stops[after]!];
  const span = b.time - a.time;
  const s = (time - a.time) / span;
  const places = [after - 2, after - 1, after, after + 1].map(
    (i) => stops[Math.min(Math.max(i, 0), stops.length - 1)]!,
  );
  const points = places.map(positionOf);
  /** Velocity at the second or third of the four stops. */
  const velocity = (i: 1 | 2, axis: number): number =>
    (points[i + 1]![axis]! - points[i - 1]![axis]!) / (places[i + 1]!.time - places[i - 1]!.time);
  // A cubic by its ends and their velocities (Hermite).
  const position = [0, 1, 2].map(
    (axis) =>
      (1 + 2 * s) * (1 - s) ** 2 * points[1]![axis]! +
      s * (1 - s) ** 2 * span * velocity(1, axis) +
      s * s * (3 - 2 * s) * points[2]![axis]! +
      s * s * (s - 1) * span * velocity(2, axis),
  ) as Vector;
  const rotation = matrixOf(slerp(quaternionOf(a.rotation), quaternionOf(b.rotation), s));
  const focal = (key: "fx" | "fy"): number => (a[key] / a.height) * (1 - s) + (b[key] / b.height) * s;
  const width = (a.width / a.height) * (1 - s) + (b.width / b.height) * s;
  return {
    height: 1,
    width,
    fx: focal("fx"),
    fy: focal("fy"),
    rotation,
    translation: translationOf(rotation, position),
  };
}

/** Plays a camera path; a pause keeps its time. */
export class PathPlayer {
  private time = 0;

  constructor(private readonly path: CameraPath) {}

  /** Return the motion that goes on where the path was paused, or begins it again at its end. */
  motion(): Motion {
    const end = this.path.stops.at(-1)!.time;
    if (this.time >= end) this.time = 0;
    return (camera, seconds) => {
      this.time += seconds;
      if (this.path.loop) this.time %= end;
      camera.setPose(poseAt(this.path, this.time));
      return this.time < end;
    };
  }
}
