import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { planesOf, readCodes } from "./grid.js";
import { checkParams, checkPlanes, type StreamRecord } from "./records.js";

/** Parameters of a vq stream (SPEC 6.7). */
export interface IndexParams {
  readonly codebook: number;
  /** Number of escape rows, which the chunk holds itself, with indices after the codebook's rows. */
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

/** Read indices below `size` + `escapes` into a column of u32. */
export function readIndices(k: Kernels, stream: StreamRecord, size: number, escapes: number): number {
  const limit = size + escapes;
  checkPlanes(stream, planesOf(limit));
  return readCodes(k, stream.planes, stream.rows, limit, "index-range");
}
