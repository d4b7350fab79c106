import type { Pose } from "./poses.js";

/** Bounding boxes of chunks, six numbers each: minimum corner, then maximum corner. */
export type Boxes = ArrayLike<number>;

/** Near plane: splats whose mean is nearer are not drawn (SPEC 8.7). */
const NEAR = 0.2;

/** Return a point in the space of a pose: right, down, forward. */
function local({ position, rotation }: Pose, x: number, y: number, z: number): [number, number, number] {
  const dx = x - position[0]!;
  const dy = y - position[1]!;
  const dz = z - position[2]!;
  const row = (i: number): number => rotation[i]! * dx + rotation[i + 1]! * dy + rotation[i + 2]! * dz;
  return [row(0), row(3), row(6)];
}

/** Return the eight corners of a box in the space of a pose. */
function corners(boxes: Boxes, box: number, pose: Pose): [number, number, number][] {
  const at = 6 * box;
  return Array.from({ length: 8 }, (_, i) =>
    local(pose, boxes[at + 3 * (i & 1)]!, boxes[at + 1 + 3 * ((i >> 1) & 1)]!, boxes[at + 2 + 3 * (i >> 2)]!),
  );
}

/** Pairs of corners that an edge connects; bit k of a corner is set on the far side of axis k. */
const EDGES = [1, 2, 4].flatMap((bit) =>
  [0, 1, 2, 3, 4, 5, 6, 7].filter((corner) => !(corner & bit)).map((corner) => [corner, corner | bit] as const),
);
/** Corners of the box in hand in the space of the pose, kept because arrays of corners took most of the time. */
const [xs, ys, depths] = [new Float64Array(8), new Float64Array(8), new Float64Array(8)];

/** Return the share of the picture within the rectangle around a projected box; 0 for a box behind or outside the view. */
export function pictureShare(boxes: Boxes, box: number, { position, rotation, tanX, tanY }: Pose): number {
  const at = 6 * box;
  let ahead = 0;
  let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
  for (let corner = 0; corner < 8; corner++) {
    const dx = boxes[at + 3 * (corner & 1)]! - position[0]!;
    const dy = boxes[at + 1 + 3 * ((corner >> 1) & 1)]! - position[1]!;
    const dz = boxes[at + 2 + 3 * (corner >> 2)]! - position[2]!;
    const depth = rotation[6]! * dx + rotation[7]! * dy + rotation[8]! * dz;
    const x = rotation[0]! * dx + rotation[1]! * dy + rotation[2]! * dz;
    const y = rotation[3]! * dx + rotation[4]! * dy + rotation[5]! * dz;
    depths[corner] = depth;
    xs[corner] = x;
    ys[corner] = y;
    if (!(depth > NEAR)) continue;
    ahead++;
    left = Math.min(left, x / depth);
    right = Math.max(right, x / depth);
    top = Math.min(top, y / depth);
    bottom = Math.max(bottom, y / depth);
  }
  if (ahead === 0) return 0;
  if (ahead < 8) {
    // Where an edge passes the near plane, the part of the box that is ahead of it has a corner.
    for (const [start, end] of EDGES) {
      const from = depths[start]!;
      const to = depths[end]!;
      if (from > NEAR === to > NEAR) continue;
      const along = (NEAR - from) / (to - from);
      const x = (xs[start]! + (xs[end]! - xs[start]!) * along) / NEAR;
      const y = (ys[start]! + (ys[end]! - ys[start]!) * along) / NEAR;
      left = Math.min(left, x);
      right = Math.max(right, x);
      top = Math.min(top, y);
      bottom = Math.max(bottom, y);
    }
  }
  const wide = Math.max((Math.min(right, tanX) - Math.max(left, -tanX)) / (2 * tanX), 0);
  const high = Math.max((Math.min(bottom, tanY) - Math.max(top, -tanY)) / (2 * tanY), 0);
  return wide * high;
}

/**
 * Return the mean of `pictureShare` over the six pictures of a panorama: from a position along each axis, in both
 * directions, with tangents of 1. Boxes are parallel to these pictures, so that no corner needs to be transformed.
 */
export function panoramaShare(boxes: Boxes, box: number, position: ArrayLike<number>): number {
  const at = 6 * box;
  let sum = 0;
  for (let axis = 0; axis < 3; axis++) {
    const low = boxes[at + axis]! - position[axis]!;
    const high = boxes[at + 3 + axis]! - position[axis]!;
    for (const [near, far] of [
      [low, high],
      [-high, -low],
    ] as const) {
      if (!(far > NEAR)) continue;
      const nearest = Math.max(near, NEAR);
      let share = 1;
      for (let other = 1; other < 3; other++) {
        const across = (axis + other) % 3;
        const start = boxes[at + across]! - position[across]!;
        const end = boxes[at + 3 + across]! - position[across]!;
        const least = start / (start < 0 ? nearest : far);
        const largest = end / (end > 0 ? nearest : far);
        share *= Math.max((Math.min(largest, 1) - Math.max(least, -1)) / 2, 0);
      }
      sum += share;
    }
  }
  return sum / 6;
}

/** Return the centre of a box. */
export function centre(boxes: Boxes, box: number): [number, number, number] {
  const at = 6 * box;
  return [
    0.5 * (boxes[at]! + boxes[at + 3]!),
    0.5 * (boxes[at + 1]! + boxes[at + 4]!),
    0.5 * (boxes[at + 2]! + boxes[at + 5]!),
  ];
}

/** Return the depth of a box's centre, scene units. */
export function middleDepth(boxes: Boxes, box: number, pose: Pose): number {
  return local(pose, ...centre(boxes, box))[2];
}

/** Return the square of half the diagonal of a box. */
export function squaredRadius(boxes: Boxes, box: number): number {
  const [x, y, z] = [0, 1, 2].map((axis) => boxes[6 * box + axis + 3]! - boxes[6 * box + axis]!) as [
    number,
    number,
    number,
  ];
  return 0.25 * (x * x + y * y + z * z);
}

type Point = readonly [number, number];

/** Return whether SGSS finds a box visible: it meets the view frustum in the planes of the pose's axes. */
export function inPyramid(boxes: Boxes, box: number, pose: Pose): boolean {
  const points = corners(boxes, box, pose);
  const far = Math.max(Math.max(...points.map((point) => point[2])), NEAR);
  const wide = pose.tanX * far;
  const high = pose.tanY * far;
  const on = (a: 0 | 1 | 2, b: 0 | 1 | 2): Point[] => points.map((point) => [point[a], point[b]]);
  return (
    meet(on(0, 2), [
      [0, 0],
      [wide, far],
      [-wide, far],
    ]) &&
    meet(on(1, 2), [
      [0, 0],
      [high, far],
      [-high, far],
    ]) &&
    meet(on(0, 1), [
      [wide, high],
      [wide, -high],
      [-wide, -high],
      [-wide, high],
    ])
  );
}

/** Return whether a projected box and a convex polygon overlap: no edge of either is a separating line. */
function meet(box: readonly Point[], polygon: readonly Point[]): boolean {
  const from = (a: Point, b: Point): Point => [b[0] - a[0], b[1] - a[1]];
  const edges = [
    ...[1, 2, 4].map((i) => from(box[0]!, box[i]!)),
    ...polygon.map((point, i) => from(point, polygon[(i + 1) % polygon.length]!)),
  ];
  return edges.every(([along, up]) => {
    const ofBox = box.map(([x, y]) => along * y - up * x);
    const ofPolygon = polygon.map(([x, y]) => along * y - up * x);
    return Math.max(...ofBox) >= Math.min(...ofPolygon) && Math.max(...ofPolygon) >= Math.min(...ofBox);
  });
}
