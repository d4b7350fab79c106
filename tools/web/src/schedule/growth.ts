import type { SceneRows } from "../container/scene_rows.js";

/** Added to log scales each time that the number of splats doubles for which a held one stands. */
const PER_DOUBLING = 0.25;
/** The most that is added: a splat doubles its size. */
const MOST = 0.7;

/** A chunk or unread page below a chunk. */
export interface Child {
  /** Row in `SceneRows`. */
  readonly row: number;
  /** Minimum corner, then maximum corner, scene units. */
  readonly box: ArrayLike<number>;
  /**
   * What the child and its descendants count, rounded down to a power of two; 0 for a child that is held, or where nothing
   * counts.
   */
  readonly missing: number;
}

/**
 * Return the children, in the order of the file, of each chunk held that has a child at which splats are missing
 * (docs/streaming.md, 10). Only chunks that come after those of the last compensation layer grow.
 *
 * @param held - Numbers of the chunks held, each with its parent among them.
 * @param splats - What each row counts, `effectiveSplats`.
 */
export function childrenOf(
  held: readonly number[],
  rows: SceneRows,
  splats: ArrayLike<number>,
): Map<number, readonly Child[]> {
  const heldRows = new Set(held.map((chunk) => rows.rowOf(chunk)!));
  const order = [...rows.inFileOrder()];
  const sums = new Float64Array(rows.count);
  // A parent stands before its children.
  for (let i = order.length - 1; i >= 0; i--) {
    const row = order[i]!;
    sums[row]! += splats[row]!;
    const parent = rows.parents[row]!;
    if (parent >= 0) sums[parent]! += sums[row]!;
  }
  const found = new Map<number, Child[]>();
  for (const row of order) {
    const parent = rows.parents[row]!;
    if (!heldRows.has(parent)) continue;
    const chunk = rows.chunks[parent]!;
    const child = { row, box: rows.boxOf(row), missing: heldRows.has(row) ? 0 : powerUpTo(sums[row]!) };
    found.set(chunk, [...(found.get(chunk) ?? []), child]);
  }
  for (const [chunk, children] of found) if (children.every(({ missing }) => missing === 0)) found.delete(chunk);
  return found;
}

/**
 * Return the growth of each splat of a chunk, an addend of its three log scales. Each splat belongs to the first child whose box contains its
 * mean, if any, and grows if splats are missing at this child.
 *
 * @param means - Means of the splats, three numbers each.
 */
export function growth(means: Float32Array, children: readonly Child[]): Float32Array {
  const childOf = Int32Array.from({ length: means.length / 3 }, (_, i) =>
    children.findIndex(({ box }) =>
      [0, 1, 2].every((axis) => means[3 * i + axis]! >= box[axis]! && means[3 * i + axis]! <= box[axis + 3]!),
    ),
  );
  const counts = new Float64Array(children.length);
  for (const child of childOf) if (child >= 0) counts[child]! += 1;
  const added = children.map(({ missing }, child) =>
    missing > 0 && counts[child]! > 0
      ? Math.min(PER_DOUBLING * doublings((counts[child]! + missing) / counts[child]!), MOST)
      : 0,
  );
  return Float32Array.from(childOf, (child) => added[child] ?? 0);
}

/** Return nearly the logarithm to base 2 of a number of at least 1: straight lines between powers of two. */
function doublings(value: number): number {
  let whole = 0;
  let rest = value;
  for (; rest >= 2; rest /= 2) whole += 1;
  return whole + rest - 1;
}

/** Return the largest power of two that is not above a whole number; 0 for 0. */
function powerUpTo(value: number): number {
  let power = value > 0 ? 1 : 0;
  while (power > 0 && 2 * power <= value) power *= 2;
  return power;
}
