import type { Shifts } from "../container/compensation.js";
import { fromHalf, toHalf } from "./half_floats.js";
import { opacityOf, shiftedOpacity } from "./opacities.js";
import type { ShRows, Splats } from "./splats.js";
import type { TexelArray, Texels, TexelWidth } from "./texel_layouts.js";

// Two textures of four u32 per splat, the layout of Spark's `ExtSplats`:
//
// | texture | word | contents |
// |---|---|---|
// | centers | 0, 1, 2 | mean x, y, z, f32 |
// | centers | 3 | opacity, half float |
// | shapes | 0, 1 | DC colour ½ + 0.282·sh0, R G B, then log scale x, half floats |
// | shapes | 2 | log scales y, z, half floats |
// | shapes | 3 | axis of the rotation on an octahedron, 10 bits each, and its angle in π/4095, 12 bits |
//
// Four more textures hold the bands above DC, one word for R G B of a coefficient: three bytes of magnitudes, three
// signs, and a shared exponent of five bits.

const words = (...names: string[]): TexelWidth[] => names.map((name) => ({ name, width: 4, bytes: 4 }));
/** Textures for each SH degree. */
export const SPARK_WIDTHS: readonly (readonly TexelWidth[])[] = [
  words("centers", "shapes"),
  words("centers", "shapes", "sh1"),
  words("centers", "shapes", "sh1", "sh2"),
  words("centers", "shapes", "sh1", "sh2", "sh3a", "sh3b"),
];
const SH_C0 = 0.28209479177387814;

/** Pack rows into arrays of the sizes of `SPARK_WIDTHS`. */
export function packSpark(splats: Splats, arrays: readonly Uint32Array<ArrayBuffer>[]): void {
  const [centers, shapes, ...bands] = arrays as [Uint32Array<ArrayBuffer>, Uint32Array<ArrayBuffer>, ...Uint32Array[]];
  const { count, means, scales, quats, opacities, sh0 } = splats;
  const floats = new Float32Array(centers.buffer, centers.byteOffset, centers.length);
  for (let i = 0; i < count; i++) {
    floats.set(means.subarray(3 * i, 3 * i + 3), 4 * i);
    centers[4 * i + 3] = toHalf(opacityOf(opacities[i]!));
    const colour = (channel: number) => toHalf(sh0[3 * i + channel]! * SH_C0 + 0.5);
    const scale = (axis: number) => toHalf(scales[3 * i + axis]!);
    shapes[4 * i] = colour(0) | (colour(1) << 16);
    shapes[4 * i + 1] = colour(2) | (scale(0) << 16);
    shapes[4 * i + 2] = scale(1) | (scale(2) << 16);
    shapes[4 * i + 3] = rotation(quats[4 * i]!, quats[4 * i + 1]!, quats[4 * i + 2]!, quats[4 * i + 3]!);
  }
  packSparkBands(splats, bands);
}

/** Pack the coefficients above DC of rows into the textures after the first two. */
export function packSparkBands({ count, shDegree, shN }: ShRows, bands: readonly Uint32Array[]): void {
  const coefficients = (shDegree + 1) ** 2 - 1;
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < coefficients; k++) {
      const at = 3 * (coefficients * i + k);
      bands[k >> 2]![4 * i + (k & 3)] = sharedExponent(shN[at]!, shN[at + 1]!, shN[at + 2]!);
    }
  }
}

/** Add shifts of compensation to rows already in `targets`. */
export function shiftSpark(
  { arrays, count }: Texels,
  shifts: Shifts,
  targets: readonly TexelArray[],
  first: number,
): void {
  const [centers, shapes] = arrays as readonly [Uint32Array, Uint32Array];
  const [toCenters, toShapes] = targets as readonly [Uint32Array, Uint32Array];
  for (let i = 0; i < count; i++) {
    const at = 4 * (first + i);
    const scale = (half: number) => toHalf(fromHalf(half) + shifts.scales[i]!);
    toCenters[at + 3] = toHalf(shiftedOpacity(fromHalf(centers[4 * i + 3]!), shifts.opacities[i]!));
    toShapes[at + 1] = (shapes[4 * i + 1]! & 0xffff) | (scale(shapes[4 * i + 1]! >>> 16) << 16);
    toShapes[at + 2] = scale(shapes[4 * i + 2]! & 0xffff) | (scale(shapes[4 * i + 2]! >>> 16) << 16);
  }
}

/** Return a rotation as its axis on an octahedron, 10 bits each, and its angle, 12 bits. */
function rotation(w: number, x: number, y: number, z: number): number {
  const sum = Math.abs(x) + Math.abs(y) + Math.abs(z);
  let [u, v] = sum < 1e-9 ? [1, 0] : [x / sum, y / sum];
  if (z < 0) [u, v] = [(1 - Math.abs(v)) * (u < 0 ? -1 : 1), (1 - Math.abs(u)) * (v < 0 ? -1 : 1)];
  // atan2 keeps the precision that acos of w loses near the identity.
  const angle = 2 * Math.atan2(Math.hypot(x, y, z), w);
  const [codeU, codeV] = [Math.round((u / 2 + 0.5) * 1023), Math.round((v / 2 + 0.5) * 1023)];
  return codeU | (codeV << 10) | (Math.min(Math.round((angle / Math.PI) * 4095), 4095) << 20);
}

const magnitude = new Float32Array(1);
const magnitudeBits = new Uint32Array(magnitude.buffer);

/** Return three numbers as bytes of magnitude, their signs, and the power of two that 255 stands for. */
function sharedExponent(r: number, g: number, b: number): number {
  const largest = Math.max(Math.abs(r), Math.abs(g), Math.abs(b));
  magnitude[0] = largest;
  // The smallest power of two at least as large as the largest magnitude; values beyond the range are clamped.
  const above = (magnitudeBits[0]! & 0x7fffff) === 0 ? 0 : 1;
  const exponent = Math.min(Math.max((magnitudeBits[0]! >>> 23) - 127 + above, -15), 16);
  const factor = 255 / 2 ** exponent;
  const byte = (value: number) => Math.min(Math.round(Math.abs(value) * factor), 255);
  const signs = (r < 0 ? 1 : 0) | (g < 0 ? 2 : 0) | (b < 0 ? 4 : 0);
  return byte(r) | (byte(g) << 8) | (byte(b) << 16) | (signs << 24) | ((exponent + 15) << 27);
}
