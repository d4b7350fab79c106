import type { PackedSplats } from "../scene/packed_splats.js";
import type { Vector } from "./orbit.js";

/**
 * Share of the weight outside the frame at each end of an axis, so that far background splats do not shrink the rest.
 */
const OUTSIDE = 0.25;
/** Size of the picture relative to the framed part. */
const MARGIN = 1.7;
/** Share of the opacity outside an object at each end of an axis: single stray splats. */
const STRAY = 0.02;
/**
 * Largest extent of an object relative to its bulk. An evenly filled ball has 1.4, a trained person and a toy 1.45 and
 * 1.49, the contents of a room 1.6, a scene under a sky 3 and more.
 */
const OBJECT_REACH = 1.55;
/** Size of the picture relative to an object. */
const OBJECT_MARGIN = 1.3;
/** Cosine of 20 degrees, the half angle of the picture's centre. */
const COSINE_OF_MIDDLE = 0.94;

/** A ball around an object or around the bulk of a scene. */
export interface Bulk {
  readonly centre: Vector;
  /** Radius of the ball, scene units. */
  readonly radius: number;
}

/** Maximum number of sampled splats; their quantiles are accurate enough and take less time than a picture. */
const MOST_SPLATS = 2048;
/** Step of a packed log scale. */
const SCALE_STEP = 21 / 254;

/**
 * Return the ball that the first picture frames: around a whole object, or around the bulk of a scene.
 *
 * @param packed - Splats, of which an even sample is evaluated.
 * @param zero - Origin of the ball's space, in the space of the packed means.
 * @returns undefined if the radius is 0 or not finite.
 */
export function bulkOf(packed: PackedSplats, zero: Vector): Bulk | undefined {
  const { means, weights, opacities } = sampleOf(packed, zero);
  const axes = [0, 1, 2].map((axis) => {
    const values = Float32Array.from(weights, (_, i) => means[3 * i + axis]!);
    return { values, order: ascending(values) };
  });
  const inner = ballAround(axes, weights, OUTSIDE, MARGIN);
  const outer = ballAround(axes, opacities, STRAY, 1);
  const found =
    outer.radius <= OBJECT_REACH * inner.radius ? { ...outer, radius: OBJECT_MARGIN * outer.radius } : inner;
  return found.radius > 0 && Number.isFinite(found.radius) ? found : undefined;
}

/** Return the ball around the box between two quantiles of each axis, enlarged by a margin. */
function ballAround(axes: readonly Sorted[], weights: Float32Array, outside: number, margin: number): Bulk {
  const ends = axes.map((axis) => [quantile(axis, weights, outside), quantile(axis, weights, 1 - outside)] as const);
  const centre = ends.map(([lo, hi]) => (lo + hi) / 2) as Vector;
  return { centre, radius: margin * Math.hypot(...ends.map(([lo, hi]) => (hi - lo) / 2)) };
}

/**
 * Return the distance from a camera to the splats in the centre of its picture, for the centre of an orbit.
 *
 * @param zero - Origin of the camera's space, in the space of the packed means.
 * @param position - Position of the camera.
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
  return weights.some((weight) => weight > 0)
    ? quantile({ values: depths, order: ascending(depths) }, weights, 0.5)
    : undefined;
}

/** A sample of splats: means, weights and opacities. */
interface Sample {
  readonly means: Float32Array;
  readonly weights: Float32Array;
  readonly opacities: Float32Array;
}

/** Sample splats evenly. Opaque and small splats have the largest weights, because a sky consists of large ones. */
function sampleOf({ count, words, means }: PackedSplats, zero: Vector): Sample {
  const step = Math.max(1, Math.ceil(count / MOST_SPLATS));
  const size = Math.ceil(count / step);
  const sample = new Uint32Array(4 * size);
  for (let i = 0; i < size; i++) sample.set(words.subarray(4 * i * step, 4 * i * step + 4), 4 * i);
  const opacities = Float32Array.from({ length: size }, (_, i) => sample[4 * i]! >>> 24);
  return {
    means: Float32Array.from(
      { length: 3 * size },
      (_, i) => means[3 * step * Math.floor(i / 3) + (i % 3)]! - zero[i % 3]!,
    ),
    weights: opacities.map((opacity, i) => {
      const word = sample[4 * i + 3]!;
      const steps = (word & 255) + ((word >>> 8) & 255) + ((word >>> 16) & 255);
      return opacity * Math.exp((-steps * SCALE_STEP) / 3);
    }),
    opacities,
  };
}

/** Numbers, and their indices in ascending order. */
interface Sorted {
  readonly values: Float32Array;
  readonly order: Uint32Array;
}

/** Return the indices that sort values in ascending order. */
function ascending(values: Float32Array): Uint32Array {
  return Uint32Array.from(values, (_, i) => i).sort((a, b) => values[a]! - values[b]!);
}

/** Return the value below which values have a share of the total weight. */
function quantile({ values, order }: Sorted, weights: Float32Array, share: number): number {
  const total = weights.reduce((sum, weight) => sum + weight, 0);
  let below = 0;
  for (const i of order) {
    below += weights[i]!;
    if (below > share * total) return values[i]!;
  }
  return values[order.at(-1) ?? 0] ?? 0;
}
