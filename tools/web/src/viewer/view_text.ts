import { type Axes, add, cross, dot, scaled, type Vector } from "./vectors.js";
import type { ViewerPose } from "./viewer_handle.js";

/** A pose as its text states it: `x,y,z,tx,ty,tz,fov` or `x,y,z,tx,ty,tz,fov,roll`. */
export interface ViewText {
  /** Position of the camera, in the space of the means. */
  readonly position: Vector;
  /** Point that the camera looks at, in the space of the means. */
  readonly target: Vector;
  /** Vertical field of view, degrees. */
  readonly fov: number;
  /** Rotation about the direction of view, degrees, clockwise as the camera sees it; 0 is level. */
  readonly roll: number;
}

const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$/;
/** Significant digits of a number in text. */
const DIGITS = 7;
/** Coordinates below this share of the largest are rounding errors of the pose, and become 0. */
const ROUNDING = 1e-12;
/** Fields of view, degrees. */
const [LEAST_FOV, MOST_FOV] = [0.1, 170];
/** Sine of the angle to the vertical below which a direction of view has no level picture. */
const STEEP = 1e-6;
const RADIANS = Math.PI / 180;

/**
 * Parse the text of a pose.
 *
 * @throws SyntaxError if the text is none.
 */
export function parseView(text: string): ViewText {
  const numbers = numbersOf(text);
  if (numbers === undefined || (numbers.length !== 7 && numbers.length !== 8)) {
    throw refusal(text, "expected x,y,z,tx,ty,tz,fov or x,y,z,tx,ty,tz,fov,roll");
  }
  const position = numbers.slice(0, 3) as Vector;
  const target = numbers.slice(3, 6) as Vector;
  if (position.every((value, axis) => value === target[axis])) {
    throw refusal(text, "position and target are one point, expected two");
  }
  const [fov, roll] = [numbers[6]!, numbers[7] ?? 0];
  if (!(fov >= LEAST_FOV && fov <= MOST_FOV)) {
    throw refusal(text, `a field of view of ${fov} degrees, expected ${LEAST_FOV} to ${MOST_FOV}`);
  }
  return { position, target, fov, roll };
}

/**
 * Parse the text of an up direction, `x,y,z` or an axis such as `+y`, into a unit vector.
 *
 * @throws SyntaxError if the text is none.
 */
export function parseUp(text: string): Vector {
  const axis = /^([+-])([xyz])$/.exec(text.trim().toLowerCase());
  if (axis !== null) {
    return [..."xyz"].map((name) => (name === axis[2] ? Number(`${axis[1]}1`) : 0)) as Vector;
  }
  const numbers = numbersOf(text);
  const largest = Math.max(...(numbers ?? []).map(Math.abs));
  if (numbers?.length !== 3 || largest === 0) {
    throw refusal(text, "expected x,y,z or one of +x, -x, +y, -y, +z, -z");
  }
  return unit(numbers.map((value) => value / largest) as Vector);
}

/**
 * Parse the text of a point, `x,y,z`.
 *
 * @throws SyntaxError if the text is none.
 */
export function parsePoint(text: string): Vector {
  const numbers = numbersOf(text);
  if (numbers?.length !== 3) throw refusal(text, "expected x,y,z");
  return numbers as Vector;
}

/** Return right, down and forward of a camera with a pose from text. */
export function axesOf({ position, target, roll }: ViewText, up: Vector): Axes {
  const [right, down, forward] = levelAxes(unit(add(target, position, -1)), up);
  const [c, s] = [Math.cos(roll * RADIANS), Math.sin(roll * RADIANS)];
  return [add(scaled(right, c), down, s), add(scaled(down, c), right, -s), forward];
}

/** Return the pose of its text, level for an up direction but for its roll. */
export function poseOf(view: ViewText, up: Vector): ViewerPose {
  const axes = axesOf(view, up);
  const focal = 0.5 / Math.tan((view.fov * RADIANS) / 2);
  const translation = axes.map((axis) => -dot(axis, view.position));
  return { height: 1, fx: focal, fy: focal, rotation: axes.flat(), translation, target: view.target };
}

/**
 * Return the text of a pose.
 *
 * @param axes - Right, down and forward of the camera.
 * @param distance - Depth of the target, which the text puts in the middle of the picture.
 * @param fov - Vertical field of view, degrees.
 * @param up - Unit vector against gravity.
 */
export function viewText(position: Vector, axes: Axes, distance: number, fov: number, up: Vector): string {
  const level = levelAxes(axes[2], up);
  const roll = Math.atan2(dot(axes[0], level[1]), dot(axes[0], level[0])) / RADIANS;
  const places = [...position, ...add(position, axes[2], distance)];
  const least = ROUNDING * Math.max(...places.map(Math.abs));
  const numbers = [...places.map((place) => (Math.abs(place) < least ? 0 : place)), fov];
  if (Math.abs(roll) >= 0.005) numbers.push(roll);
  return numbers.map((value) => String(Number(value.toPrecision(DIGITS)) + 0)).join(",");
}

/** Return right, down and forward of a level camera that looks in a direction. */
function levelAxes(forward: Vector, up: Vector): Axes {
  let right = cross(forward, up);
  if (Math.hypot(...right) < STEEP) {
    const sizes = up.map(Math.abs);
    const flattest = sizes.indexOf(Math.min(...sizes));
    right = cross([0, 1, 2].map((axis) => (axis === flattest ? 1 : 0)) as Vector, forward);
  }
  right = unit(right);
  return [right, cross(forward, right), forward];
}

/** Parse finite numbers separated by commas; undefined if a part is no finite number. */
function numbersOf(text: string): number[] | undefined {
  const parts = text.split(",").map((part) => part.trim());
  const numbers = parts.map((part) => (NUMBER.test(part) ? Number(part) : Number.NaN));
  return numbers.every(Number.isFinite) ? numbers : undefined;
}

function unit(vector: Vector): Vector {
  return scaled(vector, 1 / Math.hypot(...vector));
}

function refusal(text: string, problem: string): SyntaxError {
  return new SyntaxError(`${JSON.stringify(text.slice(0, 80))}: ${problem}`);
}
