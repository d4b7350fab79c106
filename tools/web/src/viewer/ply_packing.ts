/** Packing of PLY rows, without WebAssembly; `src/scene/packed_splats.ts` describes the layouts. */
import { toHalf } from "../scene/half_floats.js";

const SH_C0 = 0.28209479177387814;
/** Smallest log scale of a byte. */
const LOG_MIN = -12;
const LOG_STEPS = 254 / 21;

/** Convert a number from 0 to 1 to a byte. */
function byte(value: number): number {
  return Math.round(Math.min(Math.max(value, 0), 1) * 255);
}

/** Return the code of a log scale, 1 to 255; 0 would stand for a scale of 0. */
function logScale(value: number): number {
  return Math.round(Math.min(Math.max((value - LOG_MIN) * LOG_STEPS, 0), 254)) + 1;
}

/** Return a rotation as its axis on an octahedron, two bytes, and its angle, one byte. */
function octahedral(w: number, x: number, y: number, z: number): number {
  const sum = Math.abs(x) + Math.abs(y) + Math.abs(z);
  let u = sum < 1e-6 ? 1 : x / sum;
  let v = sum < 1e-6 ? 0 : y / sum;
  if (z < 0) {
    [u, v] = [(1 - Math.abs(v)) * (u < 0 ? -1 : 1), (1 - Math.abs(u)) * (v < 0 ? -1 : 1)];
  }
  const angle = (2 * Math.acos(Math.min(w, 1))) / Math.PI;
  return byte(u / 2 + 0.5) | (byte(v / 2 + 0.5) << 8) | (byte(angle) << 16);
}

/**
 * Pack the rows of a PLY into the words of `PackedSplats`, without SH bands.
 *
 * @param columns - 14 columns: means, log scales, quaternions, logits, sh0.
 * @param rows - Number of rows.
 * @param rgbMin - DC colour of code 0.
 * @param rgbMax - DC colour of code 255.
 * @param target - Receives four words per row.
 */
export function packSplats(
  columns: readonly Float32Array[],
  rows: number,
  rgbMin: number,
  rgbMax: number,
  target: Uint32Array,
): void {
  for (let row = 0; row < rows; row++) {
    const at = (column: number) => columns[column]![row]!;
    const rgb = [11, 12, 13].map((column) => byte((at(column) * SH_C0 + 0.5 - rgbMin) / (rgbMax - rgbMin))) as [
      number,
      number,
      number,
    ];
    const alpha = byte(1 / (1 + Math.exp(-at(10))));
    const rotation = octahedral(at(6), at(7), at(8), at(9));
    target[4 * row] = rgb[0] | (rgb[1] << 8) | (rgb[2] << 16) | (alpha << 24);
    target[4 * row + 1] = toHalf(at(0)) | (toHalf(at(1)) << 16);
    target[4 * row + 2] = toHalf(at(2)) | ((rotation & 0xffff) << 16);
    target[4 * row + 3] =
      logScale(at(3)) | (logScale(at(4)) << 8) | (logScale(at(5)) << 16) | ((rotation >>> 16) << 24);
  }
}

/**
 * Pack one SH band of every row.
 *
 * @param source - Rows of `stride` floats, of which `count` from `first` on are the band.
 * @param bits - Bits per value in two's complement; the largest code stands for `range`.
 * @param words - Words per row of `target`.
 */
export function packBand(
  source: Float32Array,
  rows: number,
  stride: number,
  first: number,
  count: number,
  bits: number,
  range: number,
  words: number,
  target: Uint32Array,
): void {
  const most = 2 ** (bits - 1) - 1;
  target.fill(0, 0, rows * words);
  for (let row = 0; row < rows; row++) {
    for (let i = 0; i < count; i++) {
      const value = (source[row * stride + first + i]! * most) / range;
      const code = Math.round(Math.min(Math.max(value, -most), most)) & (2 ** bits - 1);
      const bit = i * bits;
      const word = row * words + (bit >>> 5);
      target[word]! |= code << (bit & 31);
      if ((bit & 31) + bits > 32) target[word + 1]! |= code >>> (32 - (bit & 31));
    }
  }
}
