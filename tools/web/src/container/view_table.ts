import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { readPlane, storedBytes } from "../streams/planes.js";
import { Fields } from "./fields.js";
import { parseMap } from "./msgpack.js";

/** Viewpoints of a table at most (SPEC 5.12). */
const MAX_VIEWS = 64;
/** Bytes of the plane word before the codes. */
const WORD_BYTES = 4;

/** Shares of the chunks of an index, and of the pages that it lists, in what is seen all around some viewpoints (SPEC 5.12). */
export interface ViewTable {
  readonly views: number;
  /** Chunks and pages of the index. */
  readonly chunks: number;
  /** Position of each viewpoint, three numbers, in the space of the means. */
  readonly positions: Float32Array;
  /** Share of each chunk, then of each page, in the panorama of each viewpoint, viewpoint by viewpoint. */
  readonly shares: Float64Array;
}

/** Lookup table from codes to shares, which are exact binary fractions. */
const SHARES = Float64Array.from({ length: 256 }, (_, code) =>
  code === 0 ? 0 : (2 + (code & 1)) * 2 ** ((code >> 1) - 128),
);

/**
 * Read a view table.
 *
 * @param k - Kernels, which decompress the codes.
 * @param payload - Bytes of the segment, whose CRC was checked.
 * @param chunks - Chunks and pages of the index that lists the table.
 * @param allowedBytes - Bytes of codes at most.
 */
export function readViewTable(k: Kernels, payload: Uint8Array, chunks: number, allowedBytes = Infinity): ViewTable {
  const fields = new Fields(parseMap(payload), "view table");
  const position = fields.column("position", 12);
  const views = position.byteLength / 12;
  const packed = fields.binary("codes");
  const word = packed.length < WORD_BYTES ? 0 : new DataView(packed.buffer, packed.byteOffset).getUint32(0, true);
  if (packed.length !== WORD_BYTES + storedBytes(word)) {
    throw new CogsplatError(
      "root-columns",
      `${packed.length} bytes of codes for a plane of ${storedBytes(word)} and its word`,
    );
  }
  fields.finish();
  if (views < 1 || views > MAX_VIEWS) throw fields.outOfRange("position", `${views} viewpoints`);
  const positions = Float32Array.from({ length: 3 * views }, (_, i) => position.getFloat32(4 * i, true));
  if (!positions.every(Number.isFinite)) throw fields.outOfRange("position", "a number that is not finite");
  if (views * chunks > allowedBytes) throw new CogsplatError("decoded-size", `${views * chunks} codes of a view table`);
  return { views, chunks, positions, shares: readShares(k, packed, word, views, chunks) };
}

function readShares(k: Kernels, packed: Uint8Array, word: number, views: number, chunks: number): Float64Array {
  const mark = k.mark();
  try {
    const base = k.alloc(packed.length);
    k.u8.set(packed, base);
    const plane = readPlane(k, { word, address: base + WORD_BYTES }, views * chunks);
    const codes = new Uint8Array(chunks);
    const shares = new Float64Array(views * chunks);
    for (let i = 0; i < shares.length; i++) {
      // Codes are stored as differences from the previous viewpoint, modulo 256.
      codes[i % chunks]! += k.u8[plane + i]!;
      shares[i] = SHARES[codes[i % chunks]!]!;
    }
    return shares;
  } finally {
    k.release(mark);
  }
}
