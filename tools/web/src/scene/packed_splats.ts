import type { Shifts } from "../container/compensation.js";
import { fromHalf } from "./half_floats.js";
import { opacityOf } from "./opacities.js";
import type { Splats } from "./splats.js";

/** Words per splat of each packed SH band. */
export const SH_WORDS = [2, 4, 4] as const;

/**
 * Splats packed for upload, four u32 each, within the tolerances of SPEC 8.6 except for rotations, and exact means.
 *
 * The layout of the words is that of Spark's `PackedSplats`. Rotations are up to 0.034 radians off.
 *
 * | word | bits | contents |
 * |---|---|---|
 * | 0 | 0–7, 8–15, 16–23 | DC colour ½ + 0.282·sh0, R G B, from `rgbMin` to `rgbMax` |
 * | 0 | 24–31 | opacity in 1/255 |
 * | 1 | 0–15, 16–31 | mean x, y, half floats |
 * | 2 | 0–15 | mean z, half float |
 * | 2 | 16–23, 24–31 | axis of the rotation on an octahedron: x, y from −1 to 1 in 255 steps |
 * | 3 | 0–7, 8–15, 16–23 | log scales: −12 + (code − 1)·21/254 |
 * | 3 | 24–31 | angle of the rotation in π/255 |
 *
 * SH bands hold coefficient by coefficient, channels innermost, in two's complement without gaps from bit 0: 9 values
 * of 7 bits in two words, 15 of 8 bits in four, 21 of 6 bits in four.
 */
export interface PackedSplats {
  /** Number of splats. */
  readonly count: number;
  /** Four words per splat. */
  readonly words: Uint32Array;
  /** Means, exact to the bit, scene units: three per splat. */
  readonly means: Float32Array;
  /** Packed bands from 1 to the requested degree; zeros where the tail is missing. */
  readonly sh: readonly Uint32Array[];
  readonly ranges: PackRanges;
  /**
   * Opacities per level in 1/255, from the first level that has the chunk on (SPEC 5.11); present only in scenes with
   * levels. A level whose opacities have not arrived is undefined.
   */
  readonly opacities?: readonly (Uint8Array | undefined)[];
}

/** Value ranges of the codes of packed splats; values outside are clamped. */
export interface PackRanges {
  /** DC colour of byte 0; trained scenes have DC colours outside 0 to 1, which higher bands correct. */
  readonly rgbMin: number;
  /** DC colour of byte 255. */
  readonly rgbMax: number;
  /** Magnitude of the largest code of a coefficient above DC. */
  readonly shRange: number;
}

/** Ranges that hold nearly all values of trained scenes, with steps within the tolerances of SPEC 8.6. */
export const DEFAULT_RANGES: PackRanges = { rgbMin: -0.5, rgbMax: 1.5, shRange: 1 };

/** Log scales of the codes 1 and 255. */
export const LOG_SCALE_MIN = -12;
export const LOG_SCALE_MAX = 9;

const SH_C0 = 0.28209479177387814;
/** Bits per value and values per splat of each packed band. */
const SH_BITS = [
  [7, 9],
  [8, 15],
  [6, 21],
] as const;

/** Return the opacities of logits, in 1/255. */
export function packedOpacities(logits: Float32Array): Uint8Array {
  return Uint8Array.from(logits, (logit) => Math.round(255 * opacityOf(logit)));
}

/** Return the splats with opacities multiplied by a factor from 0 to 1. */
export function fade(packed: PackedSplats, factor: number): PackedSplats {
  const fade = (word: number): number => (word & 0xffffff) | (Math.round((word >>> 24) * factor) << 24);
  return { ...packed, words: packed.words.map((word, i) => (i % 4 === 0 ? fade(word) : word)) };
}

/** Return the values that a shader reads from the words and bands of packed splats. */
export function unpackSplats({ count, words, sh, ranges }: Omit<PackedSplats, "means">): Splats {
  const { rgbMin, rgbMax, shRange } = ranges;
  const shDegree = sh.length;
  const floats = 3 * ((shDegree + 1) ** 2 - 1);
  const splats = {
    count,
    shDegree,
    means: new Float32Array(3 * count),
    scales: new Float32Array(3 * count),
    quats: new Float32Array(4 * count),
    opacities: new Float32Array(count),
    sh0: new Float32Array(3 * count),
    shN: new Float32Array(floats * count),
  };
  for (let i = 0; i < count; i++) {
    const [w0, w1, w2, w3] = words.subarray(4 * i, 4 * i + 4) as unknown as [number, number, number, number];
    splats.means.set([fromHalf(w1 & 0xffff), fromHalf(w1 >>> 16), fromHalf(w2 & 0xffff)], 3 * i);
    for (let c = 0; c < 3; c++) {
      splats.sh0[3 * i + c] = ((((w0 >>> (8 * c)) & 255) / 255) * (rgbMax - rgbMin) + rgbMin - 0.5) / SH_C0;
      splats.scales[3 * i + c] = -12 + ((((w3 >>> (8 * c)) & 255) - 1) * 21) / 254;
    }
    const alpha = (w0 >>> 24) / 255;
    splats.opacities[i] = Math.log(alpha / (1 - alpha));
    splats.quats.set(fromOctahedron((w2 >>> 16) & 255, w2 >>> 24, w3 >>> 24), 4 * i);
    let first = floats * i;
    sh.forEach((band, b) => {
      const [bits, values] = SH_BITS[b]!;
      const row = band.subarray(SH_WORDS[b]! * i, SH_WORDS[b]! * (i + 1));
      for (let v = 0; v < values; v++)
        splats.shN[first + v] = (readSigned(row, v * bits, bits) * shRange) / (2 ** (bits - 1) - 1);
      first += values;
    });
  }
  return splats;
}

/** Read a number in two's complement from the bits of a row of words. */
function readSigned(row: Uint32Array, at: number, bits: number): number {
  const word = at >>> 5;
  const shift = at & 31;
  const high = shift + bits > 32 ? row[word + 1]! << (32 - shift) : 0;
  return (((row[word]! >>> shift) | high) << (32 - bits)) >> (32 - bits);
}

/** Return the rotation w x y z of an axis on an octahedron and an angle. */
function fromOctahedron(u: number, v: number, angle: number): [number, number, number, number] {
  let [x, y] = [(u / 255) * 2 - 1, (v / 255) * 2 - 1];
  const z = 1 - Math.abs(x) - Math.abs(y);
  const fold = Math.max(-z, 0);
  x += x >= 0 ? -fold : fold;
  y += y >= 0 ? -fold : fold;
  const half = ((angle / 255) * Math.PI) / 2;
  const scale = Math.sin(half) / Math.hypot(x, y, z);
  return [Math.cos(half), x * scale, y * scale, z * scale];
}

/**
 * Add shifts of compensation (SPEC 8.5) to packed splats.
 *
 * @param words - Packed splats of one chunk, without shifts.
 * @param target - Receives the shifted words; may be `words`.
 * @param first - First word of the chunk in `target`.
 */
export function shiftPacked(words: Uint32Array, shifts: Shifts, target: Uint32Array, first: number): void {
  for (let i = 0; i < words.length / 4; i++) {
    const w3 = words[4 * i + 3]!;
    const steps = Math.round((shifts.scales[i]! * 254) / 21);
    const scale = (bit: number) => Math.min(Math.max(((w3 >>> bit) & 255) + steps, 1), 255) << bit;
    const w0 = words[4 * i]!;
    const odds = (w0 >>> 24) * Math.exp(shifts.opacities[i]!);
    const alpha = Math.round((255 * odds) / (odds + 255 - (w0 >>> 24)));
    target[first + 4 * i] = (w0 & 0xffffff) | (alpha << 24);
    target[first + 4 * i + 1] = words[4 * i + 1]!;
    target[first + 4 * i + 2] = words[4 * i + 2]!;
    target[first + 4 * i + 3] = (w3 & 0xff000000) | scale(16) | scale(8) | scale(0);
  }
}
