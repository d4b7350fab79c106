import type { Viewpoint } from "../container/root.js";

/**
 * Return five numbers that give the area of the training pixel at every place, for a viewer at a position (SPEC 8.7).
 *
 * They are x, y, z of a centre, then a and b: the area is a times the squared distance from the centre, plus b, in
 * squared scene units.
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

/** Share of the squared scale by which matrices may be uneven: transforms are rounded to float32. */
const EVEN = 1e-3;

/**
 * Return the pixel of training in the space of a camera, whose zero is the camera: x, y, z of a centre, then a and b.
 *
 * @param view - Matrix from the world to the camera, column by column.
 * @param model - Matrix from the means to the world: a turn, one scale and a shift.
 * @throws RangeError where the matrices stretch the scene unevenly, so that no circle is its pixel of training.
 */
export function trainingPixelInView(
  capture: readonly Viewpoint[],
  view: ArrayLike<number>,
  model: ArrayLike<number>,
): [number, number, number, number, number] {
  const column = (j: number) =>
    [0, 1, 2].map((i) => [0, 1, 2, 3].reduce((sum, k) => sum + view[4 * k + i]! * model[4 * j + k]!, 0));
  const dot = (a: readonly number[], b: readonly number[]) => a.reduce((sum, value, i) => sum + value * b[i]!, 0);
  const [axes, shift] = [[0, 1, 2].map(column), column(3)];
  const squaredScale = dot(axes[0]!, axes[0]!);
  const isEven = [0, 1, 2].every((i) =>
    [0, 1, 2].every((j) => Math.abs(dot(axes[i]!, axes[j]!) - (i === j ? squaredScale : 0)) <= EVEN * squaredScale),
  );
  if (!isEven) {
    const lengths = axes.map((axis) => Number(Math.hypot(...axis).toPrecision(4))).join(", ");
    throw new RangeError(
      `cogsplat: the scene's axes have lengths ${lengths}, or are skewed; scale it alike along all axes`,
    );
  }
  const position = axes.map((axis) => -dot(axis, shift) / squaredScale);
  const [x, y, z, area, rest] = trainingPixel(capture, position);
  const place = (i: number) => x * axes[0]![i]! + y * axes[1]![i]! + z * axes[2]![i]! + shift[i]!;
  return [place(0), place(1), place(2), area, rest * squaredScale];
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
