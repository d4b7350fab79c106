import { packedMeans, type PackedSplats } from "../scene/packed_splats.js";
import type { Vector } from "./orbit.js";

/** Share of the weight that lies outside, at each end of an axis: far splats of a background do not shrink the rest. */
const OUTSIDE = 0.25;
/** How much larger the picture is than what lies inside. */
const MARGIN = 1.7;
/** Cosine of 20 degrees: the middle of a picture is a cone so wide to each side. */
const COSINE_OF_MIDDLE = 0.94;

/** Where the bulk of some splats is. */
export interface Bulk {
  readonly centre: Vector;
  /** Radius of the ball around the bulk, scene units. */
  readonly radius: number;
}

/** Splats that are looked at: quantiles of so many are near enough, and take no time that a picture would need. */
const MOST_SPLATS = 2048;
/** Step of a packed log scale. */
const SCALE_STEP = 21 / 254;

/**
 * Where most of some splats is, by quantiles of each axis.
 *
 * @param zero - Where the zero of the result is, in the space of the packed means.
 */
export function bulkOf(packed: PackedSplats, zero: Vector): Bulk | undefined {
  const { means, weights } = sampleOf(packed, zero);
  const ends = [0, 1, 2].map((axis) => {
    const values = Float32Array.from(weights, (_, i) => means[3 * i + axis]!);
    return [quantile(values, weights, OUTSIDE), quantile(values, weights, 1 - OUTSIDE)] as const;
  });
  const halves = ends.map(([lo, hi]) => (hi - lo) / 2);
  const centre = ends.map(([lo, hi]) => (lo + hi) / 2) as Vector;
  const radius = MARGIN * Math.hypot(...halves);
  return radius > 0 && Number.isFinite(radius) ? { centre, radius } : undefined;
}

/**
 * How far in front of a camera the splats in the middle of its picture are: what turning goes around.
 *
 * @param zero - Where the zero of the camera's space is, in the space of the packed means.
 * @param position - Of the camera.
 * @param forward - Direction of view, of unit length.
 */
export function depthAhead(packed: PackedSplats, zero: Vector, position: Vector, forward: Vector): number | undefined {
  const { means, weights } = sampleOf(packed, zero);
  const depths = new Float32Array(weights.length);
  for (let i = 0; i < weights.length; i++) {
    const offset = [0, 1, 2].map((axis) => means[3 * i + axis]! - position[axis]!) as Vector;
    const depth = offset[0] * forward[0] + offset[1] * forward[1] + offset[2] * forward[2];
    depths[i] = depth;
    if (!(depth > COSINE_OF_MIDDLE * Math.hypot(...offset))) weights[i] = 0;
  }
  return weights.some((weight) => weight > 0) ? quantile(depths, weights, 0.5) : undefined;
}

/** Splats in even steps; opaque ones weigh most, and small ones: a sky has few and large ones, what is looked at many. */
function sampleOf({ count, words }: PackedSplats, zero: Vector): { readonly means: Float32Array; readonly weights: Float32Array } {
  const step = Math.max(1, Math.ceil(count / MOST_SPLATS));
  const size = Math.ceil(count / step);
  const sample = new Uint32Array(4 * size);
  for (let i = 0; i < size; i++) sample.set(words.subarray(4 * i * step, 4 * i * step + 4), 4 * i);
  return {
    means: packedMeans({ count: size, words: sample }).map((value, i) => value - zero[i % 3]!),
    weights: Float32Array.from({ length: size }, (_, i) => {
      const word = sample[4 * i + 3]!;
      const steps = (word & 255) + ((word >>> 8) & 255) + ((word >>> 16) & 255);
      return (sample[4 * i]! >>> 24) * Math.exp((-steps * SCALE_STEP) / 3);
    }),
  };
}

/** The value below which so much of the weight is. */
function quantile(values: Float32Array, weights: Float32Array, share: number): number {
  const order = Uint32Array.from(values, (_, i) => i).sort((a, b) => values[a]! - values[b]!);
  const total = weights.reduce((sum, weight) => sum + weight, 0);
  let below = 0;
  for (const i of order) {
    below += weights[i]!;
    if (below > share * total) return values[i]!;
  }
  return values[order.at(-1) ?? 0] ?? 0;
}
