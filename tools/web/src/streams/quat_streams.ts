import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { GRID_BYTES, planesOf, readCodes, readGrids } from "./grid.js";
import { checkPadding, readPlane } from "./planes.js";
import { checkParams, checkPlanes, type StreamRecord } from "./records.js";
import { addressTable, countExtraBits, readExtraBits, STEP_MODEL_BYTES } from "./step_model.js";

/** Value of `largest` for a stream whose first plane names the omitted component of each row (SPEC 6.6). */
const PER_ROW = 255;
/** Planes per component of swing and twist: six of symbols, one of low bits (SPEC 6.11). */
const SWING_TWIST_PLANES = 7;
/** Bits of a code in its symbol; the remaining ones are low bits (SPEC 6.11). */
const SYMBOL_BITS = 6;

/** Read quaternions of three stored components (SPEC 6.6) into four columns w x y z. */
export function readQuats(k: Kernels, stream: StreamRecord): number[] {
  const { rows, params, planes } = stream;
  checkParams(stream, 4 + 3 * GRID_BYTES);
  const largest = params.getUint8(0);
  if ((largest > 3 && largest !== PER_ROW) || params.getUint32(0, true) >>> 8 !== 0) {
    throw new CogsplatError("quat-largest", `component ${largest} left out, or padding that is set`);
  }
  const grids = readGrids(params, 4, 3, undefined, 1);
  const first = largest === PER_ROW ? 1 : 0;
  checkPlanes(
    stream,
    grids.reduce((sum, grid) => sum + planesOf(grid.levels), first),
  );
  const plane = first === 1 ? readPlane(k, planes[0]!, rows) : 0;
  if (first === 1 && k.u8.subarray(plane, plane + rows).some((component) => component > 3)) {
    throw new CogsplatError("quat-largest", "a row that leaves out a component above 3");
  }
  let next = first;
  const [a, b, c] = grids.map((grid) => {
    const count = planesOf(grid.levels);
    const codes = readCodes(k, planes.slice(next, next + count), rows, grid.levels);
    next += count;
    const target = k.alloc(4 * rows);
    k.gridValues(codes, rows, grid.step, grid.minimum, target, 1);
    return target;
  }) as [number, number, number];
  const targets = Array.from({ length: 4 }, () => k.alloc(4 * rows));
  const table = addressTable(k, targets);
  k.quats(a, b, c, rows, largest, plane, table);
  return targets;
}

/**
 * Read quaternions as swing and twist (SPEC 6.11) into four columns w x y z.
 *
 * @param scales - Columns of the rows' scales, from the head without refinement.
 */
export function readSwingTwist(k: Kernels, stream: StreamRecord, scales: readonly number[]): number[] {
  const { rows, params } = stream;
  checkParams(stream, 2 * STEP_MODEL_BYTES);
  const swing = readExtraBits(k, params, 0, scales, rows);
  const twist = readExtraBits(k, params, STEP_MODEL_BYTES, scales, rows);
  checkPlanes(stream, 3 * SWING_TWIST_PLANES);
  const [a, b, c] = [swing, swing, twist].map((extra, component) => {
    return readComponent(k, stream, component * SWING_TWIST_PLANES, extra);
  }) as [number, number, number];
  const targets = Array.from({ length: 4 }, () => k.alloc(4 * rows));
  k.swingTwistQuats(a, b, c, rows, addressTable(k, targets));
  return targets;
}

function readComponent(k: Kernels, stream: StreamRecord, first: number, extra: number): number {
  const { rows, planes } = stream;
  const counts = countExtraBits(k, extra, rows);
  const symbols = Array.from({ length: SYMBOL_BITS }, (_, i) => {
    const length = i + 1 < SYMBOL_BITS ? counts[i + 1]! : counts.subarray(SYMBOL_BITS).reduce((sum, n) => sum + n, 0);
    return readPlane(k, planes[first + i]!, length);
  });
  const bits = counts.reduce((sum, count, h) => sum + Math.max(h - SYMBOL_BITS, 0) * count, 0);
  const low = readPlane(k, planes[first + SYMBOL_BITS]!, Math.ceil(bits / 8));
  checkPadding(k, low, bits);
  const target = k.alloc(4 * rows);
  if (k.swingTwist(extra, rows, addressTable(k, symbols), low, target) !== 0) {
    throw new CogsplatError("code-range", "a code above 2 to the number of its bits");
  }
  return target;
}
