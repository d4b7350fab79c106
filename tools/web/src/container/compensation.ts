import { CogsplatError } from "../errors.js";
import { Fields } from "./fields.js";
import { parseMap } from "./msgpack.js";
import type { SceneRows } from "./scene_rows.js";

const f32 = Math.fround;
const MAX_BOOK_ROWS = 256;

/** One layer of compensation (SPEC 5.9): added to splats while only the first `chunks` chunks are present. */
export interface CompensationLayer {
  readonly chunks: number;
  /** Addend of the log scales of each chunk, in 1/128. */
  readonly scales: Int8Array;
  /** Addend of the logits of each chunk, in 1/16. */
  readonly opacities: Int8Array;
  /** Strength of the codes of each chunk, for scales and for opacities, in 1/64. */
  readonly strengths: Uint8Array;
  /** Addends of each code: log scales in 1/128, logit in 1/16. */
  readonly book: Int8Array;
  /** Codes of the splats of the chunks from `firstChunk` on. */
  readonly codes: Uint8Array;
  /** Number of chunks of the previous layer, which hold their codes there. */
  readonly firstChunk: number;
}

/**
 * Read the next layer.
 *
 * @param payload - Bytes of the segment, whose CRC was checked.
 * @param rows - Chunks and unread pages of the scene.
 * @param chunks - Chunks before the first unread page, and of the whole file.
 * @param before - Previous layer; undefined for the first.
 * @returns undefined where the layer covers chunks of an unread page.
 */
export function readLayer(
  payload: Uint8Array,
  rows: SceneRows,
  chunks: { readonly known: number; readonly all: number },
  before: CompensationLayer | undefined,
): CompensationLayer | undefined {
  const fields = new Fields(parseMap(payload), "compensation");
  const scales = int8(fields.column("scales", 1));
  const count = scales.length;
  const opacities = int8(fields.column("opacities", 1, count));
  const strengths = bytes(fields.column("strengths", 2, count));
  const book = int8(fields.column("book", 2));
  const codeBytes = bytes(fields.column("codes", 1));
  fields.finish();
  const firstChunk = before?.chunks ?? 0;
  if (count <= firstChunk || count > chunks.all) {
    throw fields.outOfRange("scales", `a layer of ${count} chunks of ${chunks.all} behind one of ${firstChunk}`);
  }
  if (count > chunks.known) return undefined;
  const bookRows = book.length / 2;
  if (bookRows > MAX_BOOK_ROWS) throw fields.outOfRange("book", `${bookRows} rows`);
  const codes = readCodes(fields, codeBytes, splatsBetween(rows, firstChunk, count), bookRows);
  return { chunks: count, scales, opacities, strengths, book, codes, firstChunk };
}

function readCodes(fields: Fields, packed: Uint8Array, splats: number, rows: number): Uint8Array {
  const bits = rows === 0 ? 0 : Math.ceil(Math.log2(rows));
  const total = rows === 0 ? 0 : splats * bits;
  if (packed.length !== Math.ceil(total / 8)) {
    throw new CogsplatError("root-columns", `${packed.length} bytes of codes for ${total} bits`);
  }
  if (total % 8 !== 0 && packed[packed.length - 1]! >>> (total % 8) !== 0) {
    throw fields.outOfRange("codes", "padding after the last code is not zero");
  }
  const codes = new Uint8Array(rows === 0 ? 0 : splats);
  for (let i = 0; i < codes.length; i++) {
    let code = 0;
    for (let t = 0; t < bits; t++) {
      const bit = i * bits + t;
      code |= ((packed[bit >>> 3]! >>> (bit & 7)) & 1) << t;
    }
    if (code >= rows) throw fields.outOfRange("codes", `code ${code} of a book of ${rows} rows`);
    codes[i] = code;
  }
  return codes;
}

/** Shifts of each splat of a chunk by compensation: of its log scales (one for all three axes) and of its logit. */
export interface Shifts {
  readonly scales: Float32Array;
  readonly opacities: Float32Array;
}

/**
 * Return the shifts of a chunk in a prefix of the file, or in a set of chunks (SPEC 8.5).
 *
 * @param layers - Layers received so far, from the first on.
 * @param rows - Chunks and unread pages of the scene.
 * @param totalChunks - Chunks of the whole file.
 * @param prefix - Number of chunks of the prefix, which ends where a known chunk or an unread page begins.
 * @param chunk - Number of a known chunk in the prefix.
 * @param share - `SetState.share` of a chunk in a set.
 * @returns undefined if the prefix is not compensated.
 */
export function shiftsOf(
  layers: readonly CompensationLayer[],
  rows: SceneRows,
  totalChunks: number,
  prefix: number,
  chunk: number,
  share: number | undefined,
): Shifts | undefined {
  if ((share ?? (prefix === totalChunks ? 1 : 0)) === 1 || layers.length === 0) return undefined;
  if (prefix <= layers[0]!.chunks) return layerShifts(layers, 0, rows, chunk);
  const above = layers.findIndex((layer) => layer.chunks >= prefix);
  if (above >= 0 && layers[above]!.chunks === prefix) return layerShifts(layers, above, rows, chunk);
  const below = (above < 0 ? layers.length : above) - 1;
  const first = layers[below]!.chunks;
  const splats = splatsOf(rows, chunk);
  const zero = { scales: new Float32Array(splats), opacities: new Float32Array(splats) };
  const u = above < 0 ? zero : layerShifts(layers, above, rows, chunk);
  if (chunk >= first) return u;
  const s = layerShifts(layers, below, rows, chunk);
  // Without a later layer, all chunks of the file or all descendants end the interpolation.
  const all = splatsBetween(rows, first, above < 0 ? totalChunks : layers[above]!.chunks);
  const t = f32(share ?? splatsBetween(rows, first, prefix) / all);
  const blend = (from: Float32Array, to: Float32Array) =>
    from.map((value, i) => f32(value + f32(f32(to[i]! - value) * t)));
  return { scales: blend(s.scales, u.scales), opacities: blend(s.opacities, u.opacities) };
}

/** Return the shifts of one layer for a chunk that it covers. */
function layerShifts(layers: readonly CompensationLayer[], number: number, rows: SceneRows, chunk: number): Shifts {
  const layer = layers[number]!;
  const splats = splatsOf(rows, chunk);
  // The codes of a chunk are in the first layer that covers it.
  const coder = layers.find((candidate) => candidate.chunks > chunk)!;
  const scale = layer.scales[chunk]! / 128;
  const opacity = layer.opacities[chunk]! / 16;
  const scaleStrength = layer.strengths[2 * chunk]! / 64;
  const opacityStrength = layer.strengths[2 * chunk + 1]! / 64;
  const scales = new Float32Array(splats).fill(scale);
  const opacities = new Float32Array(splats).fill(opacity);
  if (coder.book.length > 0) {
    const start = splatsBetween(rows, coder.firstChunk, chunk);
    for (let i = 0; i < splats; i++) {
      const code = coder.codes[start + i]!;
      // Every number here has few enough bits that float32 represents it exactly.
      scales[i] = scale + (scaleStrength * coder.book[2 * code]!) / 128;
      opacities[i] = opacity + (opacityStrength * coder.book[2 * code + 1]!) / 16;
    }
  }
  return { scales, opacities };
}

function splatsOf(rows: SceneRows, chunk: number): number {
  return rows.splats[rows.rowOf(chunk)!]!;
}

/** Return the splats between two chunks, at each of which a known chunk or an unread page begins. */
function splatsBetween(rows: SceneRows, first: number, end: number): number {
  return rows.splatsBefore(end)! - rows.splatsBefore(first)!;
}

function int8(view: DataView): Int8Array {
  return Int8Array.from({ length: view.byteLength }, (_, i) => view.getInt8(i));
}

function bytes(view: DataView): Uint8Array {
  return Uint8Array.from({ length: view.byteLength }, (_, i) => view.getUint8(i));
}
