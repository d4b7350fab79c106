import type { ViewTable } from "../container/view_table.js";
import { type Boxes, centre, inPyramid, middleDepth, panoramaShare, pictureShare, squaredRadius } from "./boxes.js";
import type { Pose, WeightedPose } from "./poses.js";

/** Smallest ratio of a chunk; a chunk that the pose does not show follows the chunks that it shows. */
export const LEAST_RATIO = 1 / 512;
/** Added to the difference of a viewpoint, so that its weight stays finite. */
const LEAST_DIFFERENCE = 0.01;
/** Weight of the average of the scored views: that of a viewpoint whose difference is 0.5. */
const AVERAGE_WEIGHT = 8;
/** Smallest half diagonal of a box, scene units. */
const LEAST_RADIUS = 1e-9;
/** Smallest share of contribution, which keeps ratios finite and gains above 0. */
export const LEAST_USUAL = 1e-12;
const NEAREST_DEPTH = 0.2;
/** SGSS: density below which a box has low priority, splats per cubic scene unit. */
const SPARSE = 10;
const EPSILON = 1e-6;

/**
 * Return for each chunk its visibility from a pose, or the ratio of its share of visibility to its share of contribution
 * (docs/streaming.md, 3 to 6).
 */
export type PoseRatios = (pose: Pose) => Float64Array;

/** Sum in array order, for results equal to the bit in Python. */
function total(values: Float64Array): number {
  let sum = 0;
  for (const value of values) sum += value;
  return sum;
}

/** Return the weighted sum of the ratios along a path. */
export function sumAlongPath(ratios: PoseRatios, path: readonly WeightedPose[]): Float64Array {
  const [[first, weight], ...rest] = path as [WeightedPose, ...WeightedPose[]];
  const sum = ratios(first).map((ratio) => ratio * weight);
  for (const [pose, share] of rest)
    ratios(pose).forEach((ratio, chunk) => {
      sum[chunk]! += ratio * share;
    });
  return sum;
}

/** Ratios of the chunks of one index, from bounding boxes (docs/streaming.md, 5). */
export function byBoxes(boxes: Boxes, contribution: Float64Array): PoseRatios {
  const visible = visibleInBoxes(boxes, contribution);
  return (pose) => ratiosOf(visible(pose), contribution);
}

/** Ratios of the chunks of one index, from the viewpoints of its view table (docs/streaming.md, 4). */
export function byViewTable(table: ViewTable, boxes: Boxes, contribution: Float64Array): PoseRatios {
  const visible = visibleInTable(table, boxes, contribution);
  return (pose) => ratiosOf(visible(pose), contribution);
}

/**
 * Estimate visibility from bounding boxes, in the unit of contributions: contribution × (μ + ρ) ÷ (depth² + ρ) for each
 * visible box, where ρ is its squared half diagonal and μ the median of ρ.
 */
export function visibleInBoxes(boxes: Boxes, contribution: Float64Array): PoseRatios {
  const radii = contribution.map((_, chunk) => squaredRadius(boxes, chunk));
  const usual = Float64Array.from(radii).sort()[(radii.length - 1) >> 1] ?? 0;
  return (pose) =>
    contribution.map((value, chunk) => {
      if (!(pictureShare(boxes, chunk, pose) > 0)) return 0;
      const depth = Math.max(middleDepth(boxes, chunk, pose), NEAREST_DEPTH);
      const radius = radii[chunk]!;
      return (value * (usual + radius)) / (depth * depth + radius);
    });
}

/**
 * Estimate visibility from the viewpoints of a view table, as shares of the picture.
 *
 * A viewpoint counts the more, the less it differs from the pose: by their distance ÷ the sum of their distances from
 * the box. One more viewpoint has the average of the scored views, for chunks that no viewpoint near the pose sees.
 */
export function visibleInTable(table: ViewTable, boxes: Boxes, contribution: Float64Array): PoseRatios {
  const { views, chunks, positions } = table;
  const viewpoints = Array.from({ length: views }, (_, view) => Array.from(positions.subarray(3 * view, 3 * view + 3)));
  // A box covers at least the share that its chunk has. Roots: a viewpoint at the box would otherwise outweigh those
  // that see it from the side of the pose.
  const coverages = table.shares.map((share, i) =>
    Math.max(panoramaShare(boxes, i % chunks, viewpoints[Math.floor(i / chunks)]!), share),
  );
  const seen = total(
    Float64Array.from(viewpoints, (_, view) => total(table.shares.subarray(view * chunks, (view + 1) * chunks))),
  );
  const usual = seen / views / (total(contribution) || 1);
  const average = contribution.map((value) => value * usual);
  const covers = average.map((share, chunk) =>
    Math.max(total(Float64Array.from(viewpoints, (_, view) => coverages[view * chunks + chunk]!)) / views, share),
  );
  const shares = joined(table.shares, average);
  const extents = joined(coverages, covers).map(Math.sqrt);
  const shown = shares.map((share, i) => (extents[i]! > 0 ? share / extents[i]! : 0));
  const centres = Array.from({ length: chunks }, (_, chunk) => centre(boxes, chunk));
  const radii = centres.map((_, chunk) => Math.max(Math.sqrt(squaredRadius(boxes, chunk)), LEAST_RADIUS));
  const reach = Float64Array.from(viewpoints.flatMap((view) => centres.map((at, i) => distance(view, at) + radii[i]!)));
  return (pose) => {
    const found = Float64Array.from({ length: chunks }, (_, chunk) => pictureShare(boxes, chunk, pose));
    // The visibility of the others is 0.
    const inPicture = Array.from(found.keys()).filter((chunk) => found[chunk]! > 0);
    const away = inPicture.map((chunk) => distance(pose.position, centres[chunk]!));
    const visible = new Float64Array(inPicture.length);
    const covered = new Float64Array(inPicture.length);
    const add = (row: number, i: number, weight: number): void => {
      visible[row]! += shown[i]! * weight;
      covered[row]! += extents[i]! * weight;
    };
    viewpoints.forEach((view, at) => {
      const moved = distance(pose.position, view);
      inPicture.forEach((chunk, row) => {
        const i = at * chunks + chunk;
        const near = 1 / (moved / (away[row]! + reach[i]!) + LEAST_DIFFERENCE);
        add(row, i, near * near * near);
      });
    });
    inPicture.forEach((chunk, row) => {
      add(row, views * chunks + chunk, AVERAGE_WEIGHT);
      found[chunk]! *= visible[row]! / (covered[row]! > 0 ? covered[row]! : 1);
    });
    return found;
  };
}

/** Return the priorities of SGSS in place of ratios; 0 for boxes that it finds invisible. */
export function bySgss(boxes: Boxes, splats: ArrayLike<number>): PoseRatios {
  const densities = Float64Array.from(splats, (count, chunk) => {
    const size = (axis: number): number => Math.max(boxes[6 * chunk + 3 + axis]! - boxes[6 * chunk + axis]!, 1e-9);
    return count / (size(0) * size(1) * size(2));
  });
  return (pose) =>
    densities.map((density, chunk) => {
      if (!inPyramid(boxes, chunk, pose)) return 0;
      if (density < SPARSE) return density * EPSILON;
      return (density * pictureShare(boxes, chunk, pose)) / (Math.max(middleDepth(boxes, chunk, pose), 0) + EPSILON);
    });
}

/** Divide each chunk's share of the visibility of one index by its share of contribution. */
function ratiosOf(visible: Float64Array, contribution: Float64Array): Float64Array {
  return overUsual(visible, contribution, total(visible), total(contribution));
}

/** Divide each chunk's share of all visibility by its share of all contribution. */
export function overUsual(
  visible: Float64Array,
  contribution: Float64Array,
  allVisible: number,
  whole: number,
): Float64Array {
  if (!(allVisible > 0) || !(whole > 0)) return visible.map(() => 1);
  return visible.map((value, chunk) =>
    Math.max(value / allVisible / Math.max(contribution[chunk]! / whole, LEAST_USUAL), LEAST_RATIO),
  );
}

/** Return the effective number of splats of each chunk when the picture is compensated (docs/streaming.md, 10). */
export function effectiveSplats(splats: ArrayLike<number>, ratios: Float64Array): number[] {
  return Array.from(ratios, (ratio, chunk) => Math.floor(splats[chunk]! * Math.min(ratio * ratio, 1)));
}

function joined(first: Float64Array, second: Float64Array): Float64Array {
  const both = new Float64Array(first.length + second.length);
  both.set(first);
  both.set(second, first.length);
  return both;
}

/** Return the distance of two points, rounded alike on all machines, which `Math.hypot` is not. */
function distance(one: readonly number[], other: readonly number[]): number {
  const dx = one[0]! - other[0]!;
  const dy = one[1]! - other[1]!;
  const dz = one[2]! - other[2]!;
  return Math.sqrt(dx * dx + dy * dy + dz * dz);
}
