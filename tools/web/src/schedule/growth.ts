import type { SceneRows } from "../container/scene_rows.js";

/** Addend of log scales for each doubling of the splats that a present one stands for, and the largest. */
const PER_DOUBLING = 0.25;
const MOST = 2;

/** A chunk or unread page below a chunk. */
export interface Child {
  /** Minimum corner, then maximum corner, scene units. */
  readonly box: ArrayLike<number>;
  /** Splats that are missing here and below, rounded down to a power of two; 0 where the child is present. */
  readonly missing: number;
}

/**
 * Return the children of each chunk of a set, in the order of the file, where any of them is missing
 * (docs/streaming.md, 10).
 *
 * @param held - Numbers of known chunks, each with its parent in the set.
 * @param splats - What each row counts.
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
    const child = { box: rows.boxOf(row), missing: heldRows.has(row) ? 0 : powerBelow(sums[row]!) };
    found.set(chunk, [...(found.get(chunk) ?? []), child]);
  }
  for (const [chunk, children] of found) if (children.every(({ missing }) => missing === 0)) found.delete(chunk);
  return found;
}

/**
 * Return the addends of the log scales of a chunk's splats: each belongs to the first child whose box contains its mean,
 * and grows if that child is missing.
 *
 * @param means - Means of the splats, three numbers each.
 */
export function growth(means: Float32Array, children: readonly Child[]): Float32Array {
  const belongs = Int32Array.from({ length: means.length / 3 }, (_, i) =>
    children.findIndex(({ box }) =>
      [0, 1, 2].every((axis) => means[3 * i + axis]! >= box[axis]! && means[3 * i + axis]! <= box[axis + 3]!),
    ),
  );
  const counts = new Float64Array(children.length);
  for (const child of belongs) if (child >= 0) counts[child]! += 1;
  const added = children.map(({ missing }, child) =>
    missing > 0 && counts[child]! > 0
      ? Math.min(PER_DOUBLING * doublings((counts[child]! + missing) / counts[child]!), MOST)
      : 0,
  );
  return Float32Array.from(belongs, (child) => added[child] ?? 0);
}

/** Return nearly the logarithm to base 2 of a number of at least 1: straight lines between powers of two. */
function doublings(value: number): number {
  let whole = 0;
  let rest = value;
  for (; rest >= 2; rest /= 2) whole += 1;
  return whole + rest - 1;
}

/** Return the largest power of two that is not above a whole number; 0 for 0. */
function powerBelow(value: number): number {
  let power = value > 0 ? 1 : 0;
  while (power > 0 && 2 * power <= value) power *= 2;
  return power;
}
