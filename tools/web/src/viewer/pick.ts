import { DEFAULT_RANGES, unpackSplats } from "../scene/packed_splats.js";
import type { Vector } from "./orbit.js";
import type { ShaderRows } from "./shader_rows.js";

/** Rows evaluated at most, which take some 15 ms. Of larger scenes an even sample stands for all rows. */
const MOST_ROWS = 1_000_000;
/** Extent of a splat that can matter, standard deviations. */
const REACH = 3;
/** Least opacity of splats, in 1/255, that count. */
const LEAST_OPACITY = 6;
/** Least opacity of a ray that hits anything. */
const LEAST_HIT = 0.2;

/** A ray in the space of the means. */
export interface Ray {
  readonly origin: Vector;
  /** Unit vector. */
  readonly direction: Vector;
  /** Width of a pixel at a distance of 1. */
  readonly pixel: number;
}

/**
 * Return the distance at which a ray has lost half of the light that the scene takes from it.
 *
 * @returns undefined where the ray passes the scene.
 */
export function pick({ splats, shapes }: ShaderRows, rows: number, ray: Ray): number | undefined {
  const { origin, direction, pixel } = ray;
  const means = new Float32Array(splats.buffer);
  const reaches = Float32Array.from({ length: 256 }, (_, code) => REACH * Math.exp(-12 + ((code - 1) * 21) / 254));
  const [ox, oy, oz] = origin;
  const [dx, dy, dz] = direction;
  const step = Math.ceil(rows / MOST_ROWS);
  const near: number[] = [];
  for (let row = 0; row < rows; row += step) {
    const at = 4 * row;
    if (splats[at + 3]! >>> 24 < LEAST_OPACITY) continue;
    const x = means[at]! - ox;
    const y = means[at + 1]! - oy;
    const z = means[at + 2]! - oz;
    const along = x * dx + y * dy + z * dz;
    if (along <= 0) continue;
    const scales = shapes[2 * row + 1]!;
    const largest = Math.max(scales & 255, (scales >>> 8) & 255, (scales >>> 16) & 255);
    const reach = reaches[largest]! + along * pixel;
    if (x * x + y * y + z * z - along * along < reach * reach) near.push(row);
  }
  return depthOfHalf(
    near.map((row) => {
      const words = Uint32Array.of(splats[4 * row + 3]!, 0, shapes[2 * row]!, shapes[2 * row + 1]!);
      return crossing(words, means.subarray(4 * row, 4 * row + 3), ray, step);
    }),
  );
}

/** A splat on the way of a ray. */
interface Crossing {
  /** Distance of its densest point on the ray. */
  readonly distance: number;
  /** Share of the light that it blocks, 0 to 1. */
  readonly opacity: number;
}

/**
 * Return the densest point of a splat on a ray, and its opacity there.
 *
 * @param words - Packed splat, whose mean is not read.
 */
function crossing(words: Uint32Array, mean: Float32Array, { origin, direction, pixel }: Ray, weight: number): Crossing {
  const { scales, quats } = unpackSplats({ count: 1, words, sh: [], ranges: DEFAULT_RANGES });
  const offset = origin.map((value, i) => value - mean[i]!) as Vector;
  const far = Math.hypot(...offset);
  const [w, x, y, z] = quats as unknown as [number, number, number, number];
  // Columns of the rotation: the axes of the splat.
  const axes = [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ] as const;
  let [dd, od, oo] = [0, 0, 0];
  axes.forEach((axis, i) => {
    // No splat is thinner than a pixel of the picture.
    const size = Math.hypot(Math.exp(scales[i]!), far * pixel);
    const d = (axis[0] * direction[0] + axis[1] * direction[1] + axis[2] * direction[2]) / size;
    const o = (axis[0] * offset[0] + axis[1] * offset[1] + axis[2] * offset[2]) / size;
    dd += d * d;
    od += o * d;
    oo += o * o;
  });
  const opacity = ((words[0]! >>> 24) / 255) * Math.exp(-0.5 * Math.max(oo - (od * od) / dd, 0));
  return { distance: -od / dd, opacity: 1 - (1 - Math.min(opacity, 0.99)) ** weight };
}

/** Return the distance at which half of the opacity of all crossings is reached. */
function depthOfHalf(crossings: readonly Crossing[]): number | undefined {
  const inOrder = crossings.filter(({ distance }) => distance > 0).sort((a, b) => a.distance - b.distance);
  const left = inOrder.reduce((light, { opacity }) => light * (1 - opacity), 1);
  if (1 - left < LEAST_HIT) return undefined;
  let light = 1;
  return inOrder.find(({ opacity }) => {
    light *= 1 - opacity;
    return 1 - light >= 0.5 * (1 - left);
  })?.distance;
}
