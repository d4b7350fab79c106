export type Vector = [number, number, number];
/** Right, down and forward of a camera in the space of the means. */
export type Axes = [Vector, Vector, Vector];

/** Return a + factor · b. */
export function add(a: Vector, b: Vector, factor: number): Vector {
  return [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
}

export function scaled(v: Vector, factor: number): Vector {
  return [v[0] * factor, v[1] * factor, v[2] * factor];
}

export function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function cross(a: Vector, b: Vector): Vector {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** Rotate a vector about an axis of unit length (Rodrigues). */
export function rotate(v: Vector, axis: Vector, angle: number): Vector {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const along = dot(axis, v);
  const side = cross(axis, v);
  return v.map((value, i) => value * c + side[i]! * s + axis[i]! * along * (1 - c)) as Vector;
}
