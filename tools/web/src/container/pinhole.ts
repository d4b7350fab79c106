import type { Fields } from "./fields.js";

/** A pinhole camera as SPEC 4.4 has it: world to camera, x right, y down, z forward. */
export interface Pinhole {
  /** px */
  readonly width: number;
  /** px */
  readonly height: number;
  /** Focal lengths and principal point, px. */
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  /** R, row by row. */
  readonly rotation: readonly number[];
  /** t of x_camera = R·x + t, scene units. */
  readonly translation: readonly number[];
}

/** How far an entry of R·Rᵀ may be from the identity's (SPEC 4.4). */
const ORTHOGONALITY = 1e-3;

/** Read the root's `first_view`. */
export function readFirstView(fields: Fields): Pinhole {
  const focal = (value: number) => value > 0 && Number.isFinite(value);
  const view: Pinhole = {
    width: fields.integer("width", 1, 65_535),
    height: fields.integer("height", 1, 65_535),
    fx: fields.float("fx", focal, "a focal length"),
    fy: fields.float("fy", focal, "a focal length"),
    cx: fields.float("cx", Number.isFinite, "finite"),
    cy: fields.float("cy", Number.isFinite, "finite"),
    rotation: fields.floats("rotation", 9),
    translation: fields.floats("translation", 3),
  };
  if (!isRotation(view.rotation)) throw fields.outOfRange("rotation", "no rotation matrix");
  fields.finish();
  return view;
}

/** Whether nine numbers, row by row, are a rotation within the tolerance of SPEC 4.4. */
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
