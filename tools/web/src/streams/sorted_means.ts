import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { GRID_BYTES, readGrids } from "./grid.js";
import { checkPadding, readPlane } from "./planes.js";
import { checkParams, checkPlanes, type StreamRecord } from "./records.js";
import { addressTable, countExtraBits, readExtraBits, STEP_MODEL_BYTES } from "./step_model.js";

/** Levels of an axis of the coarse grid at most (SPEC 6.5). */
const MAX_LEVELS = 2 ** 17;
/** Bits per axis of a refinement at most (SPEC 6.17). */
const MAX_REFINEMENT_BITS = 15;

/**
 * Read means in Morton order on a coarse grid, with extra bits from the step model (SPEC 6.5, 6.15, 6.17).
 *
 * @param scales - Columns of the rows' scales, from the head without refinement.
 * @param refinement - Bits stream of a refinement, if any.
 * @returns Three columns of f32.
 */
export function readSortedMeans(
  k: Kernels,
  stream: StreamRecord,
  scales: readonly number[],
  refinement?: StreamRecord,
): number[] {
  const { rows, params } = stream;
  checkParams(stream, 3 * GRID_BYTES + STEP_MODEL_BYTES);
  const grids = readGrids(params, 0, 3, MAX_LEVELS);
  const extra = readExtraBits(k, params, 3 * GRID_BYTES, scales, rows);
  checkPlanes(stream, 3);
  const codes = readMorton(k, stream);
  grids.forEach((grid, axis) => {
    if (k.below(codes[axis]!, rows, grid.levels) !== 0) {
      throw new CogsplatError("code-range", `an axis code of ${grid.levels} or more`);
    }
  });
  const counts = countExtraBits(k, extra, rows);
  const total = 3 * counts.reduce((sum, count, bits) => sum + bits * count, 0);
  const low = readBits(k, stream, 2, total);
  const [refined, refinementBits] = refinement === undefined ? [0, 0] : readRefinement(k, refinement);
  const targets = grids.map(() => k.alloc(4 * rows));
  const axes = k.alloc(24);
  grids.forEach((grid, axis) => {
    k.f32.set([grid.step, grid.minimum], (axes >>> 2) + 2 * axis);
  });
  const table = addressTable(k, targets);
  const [x, y, z] = codes;
  if (k.sortedMeans(x, y, z, extra, rows, low, refined, refinementBits, axes, table) !== 0) {
    throw new CogsplatError("code-range", "a refined axis code below 0");
  }
  return targets;
}

/** Read axis codes from planes 0 and 1. */
function readMorton(k: Kernels, stream: StreamRecord): [number, number, number] {
  const { rows } = stream;
  const classes = readPlane(k, stream.planes[0]!, rows);
  const total = k.mortonBits(classes, rows);
  if (total < 0) throw new CogsplatError("morton-class", "a difference of more than 51 bits");
  const bits = readPlane(k, stream.planes[1]!, Math.ceil(total / 8));
  checkPadding(k, bits, total);
  const [x, y, z] = [k.alloc(4 * rows), k.alloc(4 * rows), k.alloc(4 * rows)];
  if (k.morton(classes, rows, bits, x, y, z) !== 0) {
    throw new CogsplatError("morton-range", "a Morton code of more than 51 bits");
  }
  return [x, y, z];
}

/** Read the refinement bits of each axis of each row; return their address and their number per axis. */
function readRefinement(k: Kernels, stream: StreamRecord): [number, number] {
  checkParams(stream, 4);
  const count = stream.params.getUint8(0);
  if (count < 1 || count > MAX_REFINEMENT_BITS || stream.params.getUint32(0, true) >>> 8 !== 0) {
    throw new CogsplatError("refinement-bits", `a refinement of ${count} bits, or reserved bytes that are set`);
  }
  checkPlanes(stream, 1);
  return [readBits(k, stream, 0, 3 * count * stream.rows), count];
}

function readBits(k: Kernels, stream: StreamRecord, plane: number, bits: number): number {
  const address = readPlane(k, stream.planes[plane]!, Math.ceil(bits / 8));
  checkPadding(k, address, bits);
  return address;
}
