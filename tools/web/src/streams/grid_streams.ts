import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { GRID_BYTES, type Grid, planesOf, readCodes, readGrids } from "./grid.js";
import { readPlane } from "./planes.js";
import { Attribute, checkParams, checkPlanes, Kind, type StreamRecord } from "./records.js";

/** Length of the axes of sh0 after the grids, bytes (SPEC 6.13). */
const AXES_BYTES = 36;
/** Levels at most in streams with codes for ±∞, which must fit three byte planes too (SPEC 6.4). */
const MAX_LEVELS_WITH_INFINITIES = 2 ** 24 - 2;

/**
 * Read a stream of codes on grids: scalar, differences, or basis of sh0 (SPEC 6.4, 6.12, 6.13).
 *
 * @param stream - The stream.
 * @param refinement - Digits of a refinement (SPEC 6.16), if any.
 * @returns Address of a column of f32 for each component.
 */
export function readGridStream(k: Kernels, stream: StreamRecord, refinement?: StreamRecord): number[] {
  const { rows } = stream;
  const codes = readGridCodes(k, stream);
  const grids = refinement === undefined ? codes.grids : refineCodes(k, codes, refinement);
  const columns = grids.map((grid, i) => {
    const target = k.alloc(4 * rows);
    k.gridValues(codes.addresses[i]!, rows, grid.step, grid.minimum, target, 1);
    if (stream.infinities) k.infinities(codes.addresses[i]!, rows, grid.levels, target);
    return target;
  });
  if (stream.kind === Kind.differences && stream.attribute === Attribute.scales) {
    const [l, u, v] = columns as [number, number, number];
    k.differences(l, u, v, rows, u, v);
    return [u, v, l];
  }
  if (stream.kind === Kind.basis) {
    k.sh0Axes(columns[0]!, columns[1]!, columns[2]!, rows, codes.axes);
  }
  return columns;
}

/**
 * Read a scalar stream row by row, as SH bands are stored.
 *
 * @param target - Address of `rows` rows of one f32 per component.
 */
export function readScalarRows(k: Kernels, stream: StreamRecord, target: number): void {
  const { addresses, grids } = readGridCodes(k, stream);
  grids.forEach((grid, i) => {
    k.gridValues(addresses[i]!, stream.rows, grid.step, grid.minimum, target + 4 * i, grids.length);
  });
}

interface Codes {
  readonly addresses: number[];
  readonly grids: Grid[];
  /** Address of the axes of sh0; 0 without axes. */
  readonly axes: number;
}

function readGridCodes(k: Kernels, stream: StreamRecord): Codes {
  const { rows, components } = stream;
  checkParams(stream, GRID_BYTES * components + (stream.kind === Kind.basis ? AXES_BYTES : 0));
  const maxLevels = stream.infinities ? MAX_LEVELS_WITH_INFINITIES : undefined;
  const grids = readGrids(stream.params, 0, components, maxLevels);
  const axes = stream.kind === Kind.basis ? readAxes(k, stream) : 0;
  const limits = grids.map((grid) => grid.levels + (stream.infinities ? 2 : 0));
  checkPlanes(
    stream,
    limits.reduce((sum, limit) => sum + planesOf(limit), 0),
  );
  let plane = 0;
  const addresses = limits.map((limit) => {
    const count = planesOf(limit);
    plane += count;
    return readCodes(k, stream.planes.slice(plane - count, plane), rows, limit);
  });
  return { addresses, grids, axes };
}

/** Replace the coarse codes of the head by fine ones (SPEC 6.16); return the fine grids. */
function refineCodes(k: Kernels, codes: Codes, stream: StreamRecord): Grid[] {
  const { components, rows, params } = stream;
  checkParams(stream, (GRID_BYTES + 1) * components);
  const grids = readGrids(params, 0, components);
  const radices = grids.map((_, i) => params.getUint8(GRID_BYTES * components + i));
  if (radices.some((radix) => radix < 1 || radix > 16)) {
    throw new CogsplatError("refinement-radix", `digits of ${stream.name} of radix ${radices.join(", ")}`);
  }
  checkPlanes(stream, radices.filter((radix) => radix > 1).length);
  let next = 0;
  radices.forEach((radix, i) => {
    const plane = radix > 1 ? readPlane(k, stream.planes[next++]!, rows) : 0;
    if (k.refineDigits(codes.addresses[i]!, plane, rows, radix, grids[i]!.levels) !== 0) {
      throw new CogsplatError(
        "code-range",
        `${stream.name}: a digit of ${radix} or more, or a code of ${grids[i]!.levels} or more`,
      );
    }
  });
  return grids;
}

function readAxes(k: Kernels, stream: StreamRecord): number {
  const address = k.alloc(AXES_BYTES);
  for (let i = 0; i < 9; i++) {
    const value = stream.params.getFloat32(GRID_BYTES * 3 + 4 * i, true);
    if (!(Math.abs(value) <= 1)) throw new CogsplatError("basis-value", `an axis of sh0 with ${value}`);
    k.f32[(address >>> 2) + i] = value;
  }
  return address;
}
