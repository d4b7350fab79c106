import type { SceneInfo, Viewpoint } from "../container/root.js";
import type { View } from "./renderer.js";
import { type Axes, add, cross, dot, rotate, scaled, type Vector } from "./vectors.js";
import { viewText } from "./view_text.js";
import type { ViewerPose } from "./viewer_handle.js";

export type { Axes, Vector } from "./vectors.js";

/** Vertical field of view of scenes without a first view, radians. */
const FIELD_OF_VIEW = 1;
/** Width that is always visible, as a share of the height; on upright screens the field of view grows for it. */
const UPRIGHT_WIDTH = 0.7;
/** Turn of the camera for a movement of the pointer, radians per pixel. */
export const RADIANS_PER_PIXEL = 0.005;

/** Highest pitch of the camera, looking down or up: short of straight, where a level picture has no direction. */
const STEEPEST = (85 * Math.PI) / 180;
/** Angle below the target that the camera may reach, or below the first view if that is lower, radians. */
const BELOW = (10 * Math.PI) / 180;

/** Margin of the elevations from which the capture looked, radians: planned views, too, stop at some 40° above. */
const ELEVATION_MARGIN = (15 * Math.PI) / 180;
/** Margin of the distances from which the capture looked: a factor nearer and farther. */
const DISTANCE_MARGIN = 2;
/** Share of the viewpoints at each end of a range that may be outliers. */
const OUTLIERS = 0.05;
/** Fewest viewpoints that make up a range. */
const FEWEST_VIEWPOINTS = 8;

/** Least and greatest value. */
type Range = readonly [number, number];

/** Size of the picture to which focal lengths refer, pixels; its width if known. */
type Picture = { readonly height: number; readonly width?: number };

/** Parts of a scene from which its camera starts; only `.cogs` files have `up` and `coreBox`. */
export type OrbitScene = Pick<SceneInfo, "axes" | "box" | "firstView"> &
  Partial<Pick<SceneInfo, "up" | "coreBox" | "capture">>;

/** A camera that orbits, approaches and moves with a target, or flies. */
export class OrbitCamera {
  /** Whether the camera may look from anywhere, straight from above or below too. */
  isFree = false;
  private axes: Axes;
  /** Point that the camera orbits. */
  target: Vector;
  /** Target as the camera sees it: right, down, forward. */
  private offset: Vector;
  private readonly down: Vector;
  /** Height along up that the camera stays above. */
  private readonly ground: number;
  /** Lowest pitch of the camera downwards, radians. */
  private leastPitch = -BELOW;
  /** Elevations and distances from which the capture looked at the target, with margins. */
  private captured: { readonly pitch: Range; readonly distance: Range } | undefined;
  private focal: readonly [number, number];
  private picture: Picture;

  /** Start at the scene's first view, or in front of its bounding box. */
  constructor(scene: OrbitScene) {
    const box = scene.coreBox ?? scene.box;
    const [lo, hi] = [box.slice(0, 3), box.slice(3)];
    const size = Math.hypot(...hi.map((value, i) => value - lo[i]!));
    this.down = scene.up === undefined ? direction(scene.axes, "D") : scaled(scene.up as Vector, -1);
    this.ground = -this.down.reduce((sum, value, i) => sum + Math.max(value * lo[i]!, value * hi[i]!), 0);
    const right = cross(this.down, direction(scene.axes, "F"));
    const side = Math.hypot(...right) > 1e-3 ? right : cross(this.down, direction(scene.axes, "D"));
    const level = scaled(side, 1 / Math.hypot(...side));
    this.axes = [level, this.down, cross(level, this.down)];
    const focal = 0.5 / Math.tan(FIELD_OF_VIEW / 2);
    this.focal = [focal, focal];
    this.picture = { height: 1, width: UPRIGHT_WIDTH };
    this.offset = [0, 0, size * focal];
    this.target = lo.map((value, i) => (value + hi[i]!) / 2) as Vector;
    if (scene.firstView) {
      this.offset = [0, 0, Math.max(size / 8, 1e-3)];
      this.setPose(scene.firstView);
      this.leastPitch = Math.min(this.pitch, 0) - BELOW;
    }
    this.limitTo(scene.capture ?? []);
  }

  /** Position in the space of the means. */
  get position(): Vector {
    return this.axes.reduce((point, axis, i) => add(point, axis, -this.offset[i]!), this.target);
  }

  /** Direction of view. */
  get forward(): Vector {
    return this.axes[2];
  }

  /** Distance to the target. */
  private get distance(): number {
    return Math.hypot(...this.offset);
  }

  /** Unit vector against gravity. */
  get up(): Vector {
    return scaled(this.down, -1);
  }

  /** Pitch of the direction of view, radians downwards. */
  private get pitch(): number {
    return Math.asin(Math.min(1, Math.max(-1, dot(this.axes[2], this.down))));
  }

  /** Set the pose; without a target of its own, the target keeps its distance. */
  setPose(view: ViewerPose): void {
    const r = view.rotation;
    this.axes = [0, 3, 6].map((i) => [r[i]!, r[i + 1]!, r[i + 2]!]) as Axes;
    const position = [0, 1, 2].map(
      (i) => -this.axes.reduce((sum, axis, k) => sum + axis[i]! * view.translation[k]!, 0),
    ) as Vector;
    const target = (view.target as Vector | undefined) ?? add(position, this.axes[2], this.distance);
    this.setTarget(target, position);
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
    this.offset = [0, 0, Math.max((radius * this.focal[1]) / (0.5 * this.picture.height), 1e-3)];
  }

  /**
   * Limit turning and zooming to the elevations and distances, from the target, of the viewpoints of training.
   *
   * Too few viewpoints leave the limits of a scene without them.
   */
  private limitTo(capture: readonly Viewpoint[]): void {
    const looks = capture.map(({ position }) => {
      const way = add(this.target, position as unknown as Vector, -1);
      const distance = Math.hypot(...way);
      return { pitch: Math.asin(dot(way, this.down) / Math.max(distance, 1e-9)), distance };
    });
    if (looks.length < FEWEST_VIEWPOINTS) return;
    const [low, high] = rangeOf(looks.map(({ pitch }) => pitch));
    const [near, far] = rangeOf(looks.map(({ distance }) => distance));
    const pitch: Range = [Math.max(low - ELEVATION_MARGIN, -STEEPEST), Math.min(high + ELEVATION_MARGIN, STEEPEST)];
    this.captured = { pitch, distance: [near / DISTANCE_MARGIN, far * DISTANCE_MARGIN] };
  }

  /** Move the target to a distance in front of the camera; the picture stays the same. */
  turnAround(distance: number): void {
    const { position } = this;
    this.setTarget(add(position, this.axes[2], distance), position);
  }

  private setTarget(target: Vector, position: Vector): void {
    this.target = target;
    const way = add(target, position, -1);
    this.offset = this.axes.map((axis) => dot(axis, way)) as Vector;
  }

  /** Orbit around the target by a movement of the pointer, pixels: what lies before the target follows it. */
  turn(dx: number, dy: number): void {
    this.axes = this.axes.map((axis) => rotate(axis, this.down, dx * RADIANS_PER_PIXEL)) as Axes;
    const [right] = this.axes;
    const angle = this.allowedTurn(dy * RADIANS_PER_PIXEL);
    this.axes = this.axes.map((axis) => rotate(axis, right, -angle)) as Axes;
  }

  /** Return the part of a change of pitch, radians downwards, that stays within the limits. */
  private allowedTurn(angle: number): number {
    if (this.isFree) return angle;
    const { pitch } = this;
    const [least, most] = this.captured?.pitch ?? [this.lowestPitch(), STEEPEST];
    // Outside the limits, as after a pose was set, the camera may turn back only.
    return Math.min(Math.max(pitch + angle, Math.min(least, pitch)), Math.max(most, pitch)) - pitch;
  }

  /** Return the lowest pitch of a scene without viewpoints, radians downwards. */
  private lowestPitch(): number {
    // The camera stays above the ground: as low as the target's height over it allows at this distance.
    const height = -dot(this.target, this.down) - this.ground;
    const { distance } = this;
    const grounded = height > 0 && height < distance ? -Math.asin(height / distance) : -STEEPEST;
    return Math.max(this.leastPitch, grounded);
  }

  /** Turn the camera in place by a movement of the pointer, pixels. */
  turnInPlace(dx: number, dy: number): void {
    const position = this.position;
    const { isFree } = this;
    this.isFree = true;
    this.turn(-dx, -dy);
    this.isFree = isFree;
    this.target = this.axes.reduce((point, axis, i) => add(point, axis, this.offset[i]!), position);
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

  /** Change the distance to the target by a factor, within the limits. */
  zoom(factor: number): void {
    const { distance } = this;
    const [near, far] = (this.isFree ? undefined : this.captured?.distance) ?? [0, Infinity];
    const wanted = Math.min(Math.max(distance * factor, Math.min(near, distance)), Math.max(far, distance));
    this.offset = scaled(this.offset, wanted / distance);
  }

  /** Return the text of the pose for a canvas. */
  text(height: number, width: number): string {
    const fov = (2 * Math.atan(height / (2 * this.view(height, width).focal[1])) * 180) / Math.PI;
    return viewText(this.position, this.axes, this.offset[2], fov, this.up);
  }

  /** Return the view for a canvas; a known width is fully visible. */
  view(height: number, width = Infinity): View {
    const { position, picture } = this;
    const translation = this.axes.map((axis) => -axis.reduce((sum, value, i) => sum + value * position[i]!, 0));
    const scale = Math.min(height / picture.height, picture.width === undefined ? Infinity : width / picture.width);
    return { rotation: this.axes.flat(), translation, focal: [this.focal[0] * scale, this.focal[1] * scale] };
  }
}

/** Return the range of values without the outliers at each end. */
function rangeOf(values: readonly number[]): Range {
  const sorted = [...values].sort((a, b) => a - b);
  const skipped = Math.floor(OUTLIERS * sorted.length);
  return [sorted[skipped]!, sorted.at(-1 - skipped)!];
}

/** Return the direction in the scene of a letter of its axes. */
function direction(axes: string, letter: "D" | "F"): Vector {
  const opposite = { D: "U", F: "B" }[letter];
  return [...axes].map((axis) => (axis === letter ? 1 : axis === opposite ? -1 : 0)) as Vector;
}
