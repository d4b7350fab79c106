import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";

/** Length of a step model's six coefficients, bytes (SPEC 6.10). */
export const STEP_MODEL_BYTES = 24;
/** Largest magnitude of a coefficient (SPEC 6.10). */
const MAX_COEFFICIENT = 1e6;

/**
 * Return the number of extra bits of each row from its decoded scales (SPEC 6.10).
 *
 * @param params - Parameters of a stream; the six coefficients begin at byte `at`.
 * @param scales - Three columns of scales.
 * @returns Address of one byte per row, 0 to 15.
 */
export function readExtraBits(
  k: Kernels,
  params: DataView,
  at: number,
  scales: readonly number[],
  rows: number,
): number {
  const coefficients = k.alloc(STEP_MODEL_BYTES);
  for (let i = 0; i < 6; i++) {
    const value = params.getFloat32(at + 4 * i, true);
    if (!(Math.abs(value) <= MAX_COEFFICIENT)) throw new CogsplatError("step-model", `a coefficient of ${value}`);
    k.f32[(coefficients >>> 2) + i] = value;
  }
  const extra = k.alloc(rows);
  k.extraBits(scales[0]!, scales[1]!, scales[2]!, rows, coefficients, extra);
  return extra;
}

/** Count the rows with 0, 1, … 15 extra bits. */
export function countExtraBits(k: Kernels, extra: number, rows: number): Uint32Array {
  const counts = k.alloc(64);
  k.countBits(extra, rows, counts);
  return k.u32.slice(counts >>> 2, (counts >>> 2) + 16);
}

/** Write addresses or columns into a table in the kernels' memory. */
export function addressTable(k: Kernels, addresses: readonly number[]): number {
  const table = k.alloc(4 * addresses.length);
  k.u32.set(addresses, table >>> 2);
  return table;
}
