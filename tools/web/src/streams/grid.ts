import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { readPlane, type StoredPlane } from "./planes.js";

/** Length of a grid entry, bytes (SPEC 6.4). */
export const GRID_BYTES = 12;
const MAX_LEVELS = 2 ** 24;
const MAX_END = 2 ** 100;

/** A uniform grid of one component (SPEC 6.4). */
export interface Grid {
  readonly minimum: number;
  readonly levels: number;
  /** Distance of two levels, float32; 0 for a single level. */
  readonly step: number;
}

/**
 * Read and check grid entries: all ranges, then all levels (SPEC 7.6).
 *
 * @param params - Parameters of a stream.
 * @param at - Byte offset of the first entry.
 * @param count - Number of entries.
 * @param maxLevels - Levels at most; 2^24, or less for some kinds.
 * @param maxEnd - Largest magnitude of minimum and maximum.
 */
export function readGrids(
  params: DataView,
  at: number,
  count: number,
  maxLevels = MAX_LEVELS,
  maxEnd = MAX_END,
): Grid[] {
  const entries = Array.from({ length: count }, (_, i) => ({
    minimum: params.getFloat32(at + GRID_BYTES * i, true),
    maximum: params.getFloat32(at + GRID_BYTES * i + 4, true),
    levels: params.getUint32(at + GRID_BYTES * i + 8, true),
  }));
  for (const { minimum, maximum } of entries) {
    if (!(-maxEnd <= minimum && minimum <= maximum && maximum <= maxEnd)) {
      throw new CogsplatError("grid-value", `a grid from ${minimum} to ${maximum}`);
    }
  }
  for (const { levels } of entries) {
    if (levels < 1 || levels > maxLevels) throw new CogsplatError("grid-levels", `a grid of ${levels} levels`);
  }
  return entries.map(({ minimum, maximum, levels }) => {
    const step = levels > 1 ? Math.fround(Math.fround(maximum - minimum) / Math.fround(levels - 1)) : 0;
    return { minimum, levels, step };
  });
}

/** Return the number of byte planes of codes below `limit` (SPEC 6.4). */
export function planesOf(limit: number): number {
  return limit === 1 ? 0 : limit <= 2 ** 8 ? 1 : limit <= 2 ** 16 ? 2 : 3;
}

/**
 * Read codes from consecutive byte planes, the lowest byte first.
 *
 * @param planes - Up to three planes.
 * @param rows - Number of codes.
 * @param limit - Exclusive upper bound of the codes.
 * @param reason - Reason code for a code out of bounds.
 * @returns Address of a column of u32.
 */
export function readCodes(
  k: Kernels,
  planes: readonly StoredPlane[],
  rows: number,
  limit: number,
  reason: "code-range" | "index-range" = "code-range",
): number {
  const target = k.alloc(4 * rows);
  const [p0 = 0, p1 = 0, p2 = 0] = planes.map((plane) => readPlane(k, plane, rows));
  if (k.codes(p0, p1, p2, rows, limit, target) !== 0) throw new CogsplatError(reason, `a code of ${limit} or more`);
  return target;
}
