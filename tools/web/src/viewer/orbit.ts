import type { SceneInfo } from "../container/root.js";
import type { View } from "./renderer.js";
import type { ViewerPose } from "./viewer_handle.js";

export type Vector = [number, number, number];
/** Right, down and forward of a camera in the space of the means. */
export type Axes = [Vector, Vector, Vector];

/** Vertical field of view of scenes without a first view, radians. */
const FIELD_OF_VIEW = 1;
/** Width that is always visible, as a share of the height; on upright screens the field of view grows for it. */
const UPRIGHT_WIDTH = 0.7;
/** Turn of the camera for a movement of the pointer, radians per pixel. */
export const RADIANS_PER_PIXEL = 0.005;

/** Size of the picture to which focal lengths refer, pixels; its width if known. */
type Picture = { readonly height: number; readonly width?: number };

/** A camera that orbits, approaches and moves with a target, or flies. */
export class OrbitCamera {
  private axes: Axes;
  /** Point that the camera orbits. */
  target: Vector;
  private distance: number;
  private readonly down: Vector;
  private focal: readonly [number, number];
  private picture: Picture;

  /** Start at the scene's first view, or in front of its bounding box. */
  constructor(scene: Pick<SceneInfo, "axes" | "box" | "firstView">) {
    const [lo, hi] = [scene.box.slice(0, 3), scene.box.slice(3)];
    const size = Math.hypot(...hi.map((value, i) => value - lo[i]!));
    this.down = direction(scene.axes, "D");
    const forward = direction(scene.axes, "F");
    this.axes = [cross(this.down, forward), this.down, forward];
    const focal = 0.5 / Math.tan(FIELD_OF_VIEW / 2);
    this.focal = [focal, focal];
    this.picture = { height: 1, width: UPRIGHT_WIDTH };
    this.distance = size * focal;
    this.target = lo.map((value, i) => (value + hi[i]!) / 2) as Vector;
    if (scene.firstView) {
      this.distance = Math.max(size / 8, 1e-3);
      this.setPose(scene.firstView);
    }
  }

  /** Position in the space of the means. */
  get position(): Vector {
    return add(this.target, this.axes[2], -this.distance);
  }

  /** Direction of view. */
  get forward(): Vector {
    return this.axes[2];
  }

  /** Set the pose; without a target of its own the target keeps its distance. */
  setPose(view: ViewerPose): void {
    const r = view.rotation;
    this.axes = [0, 3, 6].map((i) => [r[i]!, r[i + 1]!, r[i + 2]!]) as Axes;
    const position = [0, 1, 2].map(
      (i) => -this.axes.reduce((sum, axis, k) => sum + axis[i]! * view.translation[k]!, 0),
    );
    const { target } = view;
    if (target !== undefined) {
      this.distance = target.reduce((sum, value, i) => sum + (value - position[i]!) * this.axes[2][i]!, 0);
    }
    this.target = add(position as Vector, this.axes[2], this.distance);
    this.focal = [view.fx, view.fy];
    this.picture = view;
  }

  /** Frame a ball from the side that the axes call the front. */
  frame(centre: Vector, radius: number): void {
    this.target = centre;
    // From slightly above, which shows the shape of scenes with a ground.
    const angle = -0.3;
    const right = this.axes[0];
    this.axes = this.axes.map((axis) => rotate(axis, right, angle)) as Axes;
    this.distance = Math.max((radius * this.focal[1]) / (0.5 * this.picture.height), 1e-3);
  }

  /** Move the target to a distance in front of the camera; the picture stays the same. */
  turnAround(distance: number): void {
    const position = this.position;
    this.distance = distance;
    this.target = add(position, this.axes[2], distance);
  }

  /** Orbit around the target by a movement of the pointer, pixels. */
  turn(dx: number, dy: number): void {
    this.axes = this.axes.map((axis) => rotate(axis, this.down, -dx * RADIANS_PER_PIXEL)) as Axes;
    const [right] = this.axes;
    this.axes = this.axes.map((axis) => rotate(axis, right, dy * RADIANS_PER_PIXEL)) as Axes;
  }

  /** Turn the camera in place by a movement of the pointer, pixels. */
  turnInPlace(dx: number, dy: number): void {
    const position = this.position;
    this.turn(-dx, -dy);
    this.target = add(position, this.axes[2], this.distance);
  }

  /** Move sideways by a movement of the pointer, pixels of a picture of some height. */
  move(dx: number, dy: number, height: number): void {
    const scale = (this.distance * this.picture.height) / (this.focal[1] * height);
    this.target = add(add(this.target, this.axes[0], -scale * dx), this.axes[1], -scale * dy);
  }

  /** Fly right, down and forward, in units of the distance to the target. */
  fly(right: number, down: number, forward: number): void {
    [right, down, forward].forEach((share, i) => {
      this.target = add(this.target, this.axes[i]!, share * this.distance);
    });
  }

  /** Change the distance to the target by a factor. */
  zoom(factor: number): void {
    this.distance *= factor;
  }

  /** Return the view for a canvas; a known width is fully visible. */
  view(height: number, width = Infinity): View {
    const { position, picture } = this;
    const translation = this.axes.map((axis) => -axis.reduce((sum, value, i) => sum + value * position[i]!, 0));
    const scale = Math.min(height / picture.height, picture.width === undefined ? Infinity : width / picture.width);
    return { rotation: this.axes.flat(), translation, focal: [this.focal[0] * scale, this.focal[1] * scale] };
  }
}

/** Return the direction in the scene of a letter of its axes. */
function direction(axes: string, letter: "D" | "F"): Vector {
  const opposite = { D: "U", F: "B" }[letter];
  return [...axes].map((axis) => (axis === letter ? 1 : axis === opposite ? -1 : 0)) as Vector;
}

function add(a: Vector, b: Vector, factor: number): Vector {
  return [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
}

function cross(a: Vector, b: Vector): Vector {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** Rotate a vector about an axis of unit length (Rodrigues). */
function rotate(v: Vector, axis: Vector, angle: number): Vector {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const along = axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2];
  const side = cross(axis, v);
  return v.map((value, i) => value * c + side[i]! * s + axis[i]! * along * (1 - c)) as Vector;
}
