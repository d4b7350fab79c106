import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { readPlane, storedBytes } from "../streams/planes.js";
import { ATTRIBUTE_TYPES, type AttributeEntry } from "./root.js";

/** Values of an extra attribute. */
export type AttributeArray =
  | Uint8Array
  | Int8Array
  | Uint16Array
  | Int16Array
  | Uint32Array
  | Int32Array
  | Float32Array
  | Float64Array;

const ARRAYS = {
  u1: Uint8Array,
  i1: Int8Array,
  u2: Uint16Array,
  i2: Int16Array,
  u4: Uint32Array,
  i4: Int32Array,
  f4: Float32Array,
  f8: Float64Array,
} as const;

/**
 * Read a chunk's extra attributes (SPEC 5.7).
 *
 * @param payload - Bytes of the segment, whose CRC was checked.
 * @param rows - Splats of the chunk.
 * @returns Values by attribute name, row by row.
 */
export function readAttributes(
  k: Kernels,
  payload: Uint8Array,
  entries: readonly AttributeEntry[],
  rows: number,
): Map<string, AttributeArray> {
  const base = k.alloc(payload.length);
  k.u8.set(payload, base);
  const counts = entries.map((entry) => Math.max(entry.components, 1) * ATTRIBUTE_TYPES[entry.type]);
  const planes = counts.reduce((sum, count) => sum + count, 0);
  const view = new DataView(payload.buffer, payload.byteOffset, payload.byteLength);
  if (4 * planes > payload.length) {
    throw new CogsplatError("attribute-record", `${payload.length} bytes for the words of ${planes} planes`);
  }
  let at = 4 * planes;
  const stored = Array.from({ length: planes }, (_, i) => {
    const word = view.getUint32(4 * i, true);
    const address = base + at;
    at += storedBytes(word);
    return { word, address };
  });
  if (at !== payload.length) {
    throw new CogsplatError("attribute-record", `words and planes of ${at} bytes in a payload of ${payload.length}`);
  }
  const values = new Map<string, AttributeArray>();
  let next = 0;
  entries.forEach((entry) => {
    const components = Math.max(entry.components, 1);
    const size = ATTRIBUTE_TYPES[entry.type];
    const bytes = new Uint8Array(rows * components * size);
    for (let component = 0; component < components; component++) {
      for (let byte = 0; byte < size; byte++) {
        const mark = k.mark();
        const plane = readPlane(k, stored[next++]!, rows);
        for (let row = 0; row < rows; row++) bytes[(row * components + component) * size + byte] = k.u8[plane + row]!;
        k.release(mark);
      }
    }
    // Typed arrays have the byte order of the machine, which is little-endian wherever WebAssembly runs.
    values.set(entry.name, new ARRAYS[entry.type](bytes.buffer));
  });
  return values;
}
