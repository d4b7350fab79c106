import type { Viewpoint } from "../container/root.js";

/**
 * Return the pixel of training as a viewer sees it: x, y, z of a centre, then a and c (SPEC 8.7).
 *
 * The area of the pixel at a place is a times its squared distance from the centre, plus c, in squared scene units.
 *
 * @param capture - Viewpoints of the training pictures; without any, all five numbers are 0.
 * @param position - Position of the viewer, in the space of the means.
 */
export function trainingPixel(
  capture: readonly Viewpoint[],
  position: readonly number[],
): [number, number, number, number, number] {
  if (capture.length === 0) return [0, 0, 0, 0, 0];
  const squares = capture.map((viewpoint) => squaredDistance(viewpoint.position, position));
  const least = Math.min(...squares);
  // Relative to the nearest viewpoint, whose own distance may be 0.
  const weights = squares.map((square) => (least > 0 ? (least / square) ** 2 : Number(square === 0)));
  const sum = weights.reduce((total, weight) => total + weight, 0);
  const areas = capture.map((viewpoint, i) => weights[i]! / sum / viewpoint.focalPx ** 2);
  const area = areas.reduce((total, value) => total + value, 0);
  const mean = (value: (i: number) => number) => areas.reduce((total, weight, i) => total + weight * value(i), 0);
  const centre = [0, 1, 2].map((axis) => mean((i) => capture[i]!.position[axis]!) / area);
  const rest = mean((i) => squaredDistance(capture[i]!.position, centre));
  return [centre[0]!, centre[1]!, centre[2]!, area, rest];
}

/** Return viewpoints moved by a vector. */
export function movedCapture(capture: readonly Viewpoint[], by: readonly number[]): Viewpoint[] {
  return capture.map(({ position: [x, y, z], focalPx }) => ({
    position: [x + by[0]!, y + by[1]!, z + by[2]!],
    focalPx,
  }));
}

function squaredDistance(a: readonly number[], b: readonly number[]): number {
  return (a[0]! - b[0]!) ** 2 + (a[1]! - b[1]!) ** 2 + (a[2]! - b[2]!) ** 2;
}
