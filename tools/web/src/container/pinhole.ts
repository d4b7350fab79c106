import type { Fields } from "./fields.js";

/** A pinhole camera (SPEC 4.4): world to camera, x right, y down, z forward. */
export interface Pinhole {
  /** Pixels. */
  readonly width: number;
  /** Pixels. */
  readonly height: number;
  /** Focal lengths and principal point, pixels. */
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  /** Rotation R, row by row. */
  readonly rotation: readonly number[];
  /** Translation t in x_camera = R·x + t, scene units. */
  readonly translation: readonly number[];
  /** Point in front of the camera that a viewer turns around, in the space of the means. */
  readonly target?: readonly number[];
}

/** Largest difference between an entry of R·Rᵀ and of the identity (SPEC 4.4). */
const ORTHOGONALITY = 1e-3;

/** Read a camera, and its target if it has one (SPEC 4.4). */
export function readPinhole(fields: Fields): Pinhole {
  const focal = (value: number) => value > 0 && Number.isFinite(value);
  const view = {
    width: fields.integer("width", 1, 65_535),
    height: fields.integer("height", 1, 65_535),
    fx: fields.float("fx", focal, "a focal length"),
    fy: fields.float("fy", focal, "a focal length"),
    cx: fields.float("cx", Number.isFinite, "finite"),
    cy: fields.float("cy", Number.isFinite, "finite"),
    rotation: readRotation(fields),
    translation: fields.floats("translation", 3),
  };
  const target = fields.has("target") ? readTarget(fields, view) : undefined;
  fields.finish();
  return target === undefined ? view : { ...view, target };
}

/** Read the target of a camera, which lies in front of it. */
function readTarget(fields: Fields, { rotation, translation }: Pick<Pinhole, "rotation" | "translation">): number[] {
  const target = fields.floats("target", 3);
  const depth = rotation[6]! * target[0]! + rotation[7]! * target[1]! + rotation[8]! * target[2]! + translation[2]!;
  if (!(depth > 0)) throw fields.outOfRange("target", `a point at depth ${depth}, not in front of the camera`);
  return target;
}

function readRotation(fields: Fields): number[] {
  const rotation = fields.floats("rotation", 9);
  if (!isRotation(rotation)) throw fields.outOfRange("rotation", "no rotation matrix");
  return rotation;
}

/** Return whether nine numbers, row by row, are a rotation within the tolerance of SPEC 4.4. */
export function isRotation(r: readonly number[]): boolean {
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j < 3; j++) {
      const product = r[3 * i]! * r[3 * j]! + r[3 * i + 1]! * r[3 * j + 1]! + r[3 * i + 2]! * r[3 * j + 2]!;
      if (!(Math.abs(product - (i === j ? 1 : 0)) <= ORTHOGONALITY)) return false;
    }
  }
  const determinant =
    r[0]! * (r[4]! * r[8]! - r[5]! * r[7]!) -
    r[1]! * (r[3]! * r[8]! - r[5]! * r[6]!) +
    r[2]! * (r[3]! * r[7]! - r[4]! * r[6]!);
  return determinant > 0;
}
