import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { planesOf, readCodes } from "./grid.js";
import { checkParams, checkPlanes, type StreamRecord } from "./records.js";

/** Parameters of a vq stream (SPEC 6.7). */
export interface IndexParams {
  readonly codebook: number;
  /** Number of escape rows, which the chunk holds itself. */
  readonly escapes: number;
}

/** Read the parameters of a vq stream. */
export function readIndexParams(stream: StreamRecord): IndexParams {
  checkParams(stream, 8);
  const codebook = stream.params.getUint32(0, true);
  const escapes = stream.params.getUint32(4, true);
  if (escapes > stream.rows) throw new CogsplatError("stream-rows", `${escapes} escape rows for ${stream.rows} rows`);
  return { codebook, escapes };
}

/** Read indices into a column of u32, with escape rows numbered from `size` on. */
export function readIndices(k: Kernels, stream: StreamRecord, size: number, escapes: number): number {
  const limit = size + Math.min(escapes, 1);
  checkPlanes(stream, planesOf(limit));
  const target = readCodes(k, stream.planes, stream.rows, limit, "index-range");
  const indices = k.u32.subarray(target >>> 2, (target >>> 2) + stream.rows);
  let next = size;
  indices.forEach((index, row) => {
    if (index === size) indices[row] = next++;
  });
  if (next !== size + escapes) {
    throw new CogsplatError("index-range", `${next - size} indices of escape rows, not ${escapes}`);
  }
  return target;
}
