import type { Shifts } from "../container/compensation.js";
import { fromHalf, toHalf } from "./half_floats.js";
import { opacityOf, shiftedOpacity } from "./opacities.js";
import type { ShRows, Splats } from "./splats.js";
import type { TexelArray, Texels, TexelWidth } from "./texel_layouts.js";

// The textures of PlayCanvas' uncompressed splats except for the rotation, whose angles near 180° its own code loses.
//
// | texture | elements | contents |
// |---|---|---|
// | dcColor | 4 half floats | DC colour ½ + 0.282·sh0, R G B, and opacity |
// | transformA | 4 u32 | mean x, y, z, f32; the three smaller components of w x y z in 10 bits each, and the index of
// the largest |
// | transformB | 4 half floats | scales x, y, z, and 0 |
// | splatSH_1to3 … 12to15 | u32 | the largest magnitude of the row, f32; R G B of each coefficient relative to it in
// 11, 10, 11 bits |

const half = (name: string): TexelWidth => ({ name, width: 4, bytes: 2 });
const words = (name: string, width = 4): TexelWidth => ({ name, width, bytes: 4 });
const PLAIN = [half("dcColor"), words("transformA"), half("transformB")];
/** Textures for each SH degree. */
export const PLAYCANVAS_WIDTHS: readonly (readonly TexelWidth[])[] = [
  PLAIN,
  [...PLAIN, words("splatSH_1to3")],
  [...PLAIN, words("splatSH_1to3"), words("splatSH_4to7"), words("splatSH_8to11", 1)],
  [...PLAIN, words("splatSH_1to3"), words("splatSH_4to7"), words("splatSH_8to11"), words("splatSH_12to15")],
];
const SH_C0 = 0.28209479177387814;
/** Largest log scale whose scale is a finite half float. */
const LARGEST_LOG_SCALE = Math.log(65504);

/** Pack rows into arrays of the sizes of `PLAYCANVAS_WIDTHS`. */
export function packPlayCanvas(splats: Splats, arrays: readonly TexelArray[]): void {
  const [color, transformA, transformB, ...bands] = arrays as [
    Uint16Array,
    Uint32Array<ArrayBuffer>,
    Uint16Array,
    ...Uint32Array[],
  ];
  const { count, means, scales, quats, opacities, sh0 } = splats;
  const floats = new Float32Array(transformA.buffer, transformA.byteOffset, transformA.length);
  for (let i = 0; i < count; i++) {
    for (let channel = 0; channel < 3; channel++) color[4 * i + channel] = toHalf(sh0[3 * i + channel]! * SH_C0 + 0.5);
    color[4 * i + 3] = toHalf(opacityOf(opacities[i]!));
    floats.set(means.subarray(3 * i, 3 * i + 3), 4 * i);
    transformA[4 * i + 3] = smallestThree(quats.subarray(4 * i, 4 * i + 4));
    for (let axis = 0; axis < 3; axis++)
      transformB[4 * i + axis] = toHalf(Math.exp(Math.min(scales[3 * i + axis]!, LARGEST_LOG_SCALE)));
  }
  if (splats.shDegree > 0) packPlayCanvasBands(splats, bands);
}

/**
 * Return the three smaller components of a unit quaternion in 10 bits each, and the index of the largest in two bits.
 */
function smallestThree(quat: Float32Array): number {
  let largest = 0;
  for (let k = 1; k < 4; k++) if (Math.abs(quat[k]!) > Math.abs(quat[largest]!)) largest = k;
  const sign = quat[largest]! < 0 ? -1 : 1;
  let word = largest << 30;
  let bit = 0;
  for (let k = 0; k < 4; k++) {
    if (k === largest) continue;
    word |= Math.round((sign * quat[k]! * Math.SQRT2 + 1) * 511.5) << bit;
    bit += 10;
  }
  return word;
}

/**
 * Pack the coefficients above DC of rows into the textures after the first three, relative to the row's largest
 * magnitude in the first word.
 */
export function packPlayCanvasBands({ count, shN, shDegree }: ShRows, bands: readonly Uint32Array[]): void {
  const coefficients = (shDegree + 1) ** 2 - 1;
  const largest = new Float32Array(1);
  const bits = new Uint32Array(largest.buffer);
  for (let i = 0; i < count; i++) {
    const row = shN.subarray(3 * coefficients * i, 3 * coefficients * (i + 1));
    largest[0] = row.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
    if (largest[0] === 0) continue;
    const part = (value: number, most: number) => Math.round((value / largest[0]! / 2 + 0.5) * most);
    bands[0]![4 * i] = bits[0]!;
    for (let k = 0; k < coefficients; k++) {
      const word = (part(row[3 * k]!, 2047) << 21) | (part(row[3 * k + 1]!, 1023) << 11) | part(row[3 * k + 2]!, 2047);
      // The word of the magnitude comes first.
      const band = bands[(k + 1) >> 2]!;
      band[(band.length / count) * i + ((k + 1) & 3)] = word;
    }
  }
}

/** Add shifts of compensation to rows already in `targets`. */
export function shiftPlayCanvas(
  { arrays, count }: Texels,
  shifts: Shifts,
  targets: readonly TexelArray[],
  first: number,
): void {
  const [color, , transformB] = arrays;
  const [toColor, , toTransformB] = targets;
  for (let i = 0; i < count; i++) {
    const at = 4 * (first + i);
    toColor![at + 3] = toHalf(shiftedOpacity(fromHalf(color![4 * i + 3]!), shifts.opacities[i]!));
    const factor = Math.exp(shifts.scales[i]!);
    for (let axis = 0; axis < 3; axis++)
      toTransformB![at + axis] = toHalf(fromHalf(transformB![4 * i + axis]!) * factor);
  }
}
