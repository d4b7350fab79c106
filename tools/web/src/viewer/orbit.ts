import type { SceneInfo } from "../container/root.js";
import type { View } from "./renderer.js";
import type { ViewerPose } from "./viewer_handle.js";

type Vector = [number, number, number];

/** Vertical field of view where the scene has no first view, radians. */
const FIELD_OF_VIEW = 1;
const RADIANS_PER_PIXEL = 0.005;

/** A camera that turns around a point, walks up to it and moves with it. */
export class OrbitCamera {
  /** World to camera: rows right, down, forward. */
  private axes: [Vector, Vector, Vector];
  private target: Vector;
  private distance: number;
  private readonly down: Vector;
  /** Focal lengths over the height of the picture. */
  private focal: [number, number];

  /** Start at the scene's first view, or in front of its box. */
  constructor(scene: SceneInfo) {
    const [lo, hi] = [scene.box.slice(0, 3), scene.box.slice(3)];
    const size = Math.hypot(...hi.map((value, i) => value - lo[i]!));
    this.down = direction(scene.axes, "D");
    const forward = direction(scene.axes, "F");
    this.axes = [cross(this.down, forward), this.down, forward];
    const focal = 0.5 / Math.tan(FIELD_OF_VIEW / 2);
    this.focal = [focal, focal];
    this.distance = size * focal;
    this.target = lo.map((value, i) => (value + hi[i]!) / 2) as Vector;
    if (scene.firstView) {
      this.distance = Math.max(size / 8, 1e-3);
      this.place(scene.firstView);
    }
  }

  /** Look from somewhere; what is turned around stays as far away as it was. */
  place(view: ViewerPose): void {
    const r = view.rotation;
    this.axes = [0, 3, 6].map((i) => [r[i]!, r[i + 1]!, r[i + 2]!]) as [Vector, Vector, Vector];
    const position = [0, 1, 2].map((i) => -this.axes.reduce((sum, axis, k) => sum + axis[i]! * view.translation[k]!, 0));
    this.target = position.map((value, i) => value + this.axes[2][i]! * this.distance) as Vector;
    this.focal = [view.fx / view.height, view.fy / view.height];
  }

  /** Turn by a movement of the pointer, px. */
  turn(dx: number, dy: number): void {
    this.axes = this.axes.map((axis) => rotate(axis, this.down, -dx * RADIANS_PER_PIXEL)) as [Vector, Vector, Vector];
    const [right] = this.axes;
    this.axes = this.axes.map((axis) => rotate(axis, right, dy * RADIANS_PER_PIXEL)) as [Vector, Vector, Vector];
  }

  /** Move sideways by a movement of the pointer, px of a picture of some height. */
  move(dx: number, dy: number, height: number): void {
    const scale = this.distance / (this.focal[1] * height);
    this.target = this.target.map((value, i) => value - scale * (dx * this.axes[0][i]! + dy * this.axes[1][i]!)) as Vector;
  }

  /** Come nearer, by a factor. */
  zoom(factor: number): void {
    this.distance *= factor;
  }

  /** The view for a canvas. */
  view(height: number): View {
    const position = this.target.map((value, i) => value - this.axes[2][i]! * this.distance);
    const translation = this.axes.map((axis) => -axis.reduce((sum, value, i) => sum + value * position[i]!, 0));
    return { rotation: this.axes.flat(), translation, focal: [this.focal[0] * height, this.focal[1] * height] };
  }
}

/** The direction in the scene that a letter of its axes names. */
function direction(axes: string, letter: "D" | "F"): Vector {
  const opposite = { D: "U", F: "B" }[letter];
  return [...axes].map((axis) => (axis === letter ? 1 : axis === opposite ? -1 : 0)) as Vector;
}

function cross(a: Vector, b: Vector): Vector {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** Turn a vector about an axis of unit length (Rodrigues). */
function rotate(v: Vector, axis: Vector, angle: number): Vector {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const along = axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2];
  const side = cross(axis, v);
  return v.map((value, i) => value * c + side[i]! * s + axis[i]! * along * (1 - c)) as Vector;
}
