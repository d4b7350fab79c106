/**
 * Scenes in Spark, splats for three.js: the entry point `cogsplat/spark`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { axesRotation } from "./axes.js";
import { editShader } from "./shader_edits.js";
import {
  type AdapterOptions,
  type AdapterStream,
  followingAbort,
  originPosition,
  sceneArrays,
  streamTexels,
  wantedDegree,
} from "./texel_stream.js";

export type { AdapterOptions, AdapterStream } from "./texel_stream.js";

/** Part of Spark's `ExtSplats` that the adapter uses. */
export interface SparkExtSplats {
  numSplats: number;
  readonly textures: readonly { needsUpdate: boolean }[];
  readonly extra: Record<string, unknown>;
  dispose(): void;
}

/** Part of Spark's `SplatMesh` that the adapter uses. */
export interface SparkMesh {
  numSplats: number;
  readonly quaternion: { set(x: number, y: number, z: number, w: number): unknown };
  readonly position: { set(x: number, y: number, z: number): unknown };
  updateVersion(): void;
  dispose(): void;
}

/** Classes of `@sparkjsdev/spark` that the adapter instantiates. */
export interface SparkModule<M extends SparkMesh> {
  readonly ExtSplats: new (options: {
    extArrays: [Uint32Array, Uint32Array];
    numSplats: number;
    extra: Record<string, unknown>;
  }) => SparkExtSplats;
  readonly SplatMesh: new (options: { extSplats: SparkExtSplats }) => M;
}

/** A scene in Spark. */
export interface SparkScene<M extends SparkMesh> extends AdapterStream {
  /** Mesh to add to a three.js scene; it fills as chunks arrive. */
  readonly mesh: M;
}

/** Settings of Spark's `SparkRenderer` that `drawBySpec` changes. */
export interface SparkSettings {
  readonly material: { vertexShader: string; needsUpdate: boolean };
  preBlurAmount: number;
  blurAmount: number;
  sortRadial: boolean;
  maxStdDev: number;
  minAlpha: number;
  maxPixelRadius: number;
  clipXY: number;
}

/** Contribution at which the extent of a splat ends (SPEC 8.7). */
const ALPHA_MIN = 1 / 255;
/** Clamping of the projection's Jacobian to 1.3 times the picture (SPEC 8.7), which Spark lacks. */
const CLAMPED_JACOBIAN = [
  [
    "vec2 J2 = -(J1 * viewCenter.xy) * invZ;",
    "vec2 edge = 1.3 * 0.5 * scaledRenderSize / focal; vec2 J2 = J1 * clamp(-viewCenter.xy * invZ, -edge, edge);",
  ],
] as const;

/**
 * Make Spark draw by SPEC 8.7: sorted by depth, with the scene's kernel, with extents to a contribution of 1/255.
 *
 * Call it before the first picture. A renderer has one kernel for all of its scenes. In a version of Spark with an
 * unknown shader, splats centred far outside the picture are hidden instead, because they would fill it.
 *
 * @param renderer - A `SparkRenderer`, made with `accumExtSplats: true`.
 * @returns Whether all rules apply.
 *
 * @example
 * ```ts
 * const renderer = new spark.SparkRenderer({ renderer: webgl, accumExtSplats: true });
 * drawBySpec(renderer, scene);
 * world.add(renderer);
 * ```
 */
export function drawBySpec(renderer: SparkSettings, { info }: Pick<StreamedScene, "info">): boolean {
  // A kernel added before Spark compares determinants leaves opacities unchanged.
  renderer.preBlurAmount = info.antialiased ? 0 : info.kernelPx;
  renderer.blurAmount = info.antialiased ? info.kernelPx : 0;
  renderer.sortRadial = false;
  renderer.maxStdDev = Math.sqrt(2 * Math.log(1 / ALPHA_MIN));
  renderer.minAlpha = ALPHA_MIN;
  renderer.maxPixelRadius = 1e6;
  const shader = editShader(renderer.material.vertexShader, CLAMPED_JACOBIAN);
  renderer.clipXY = shader === undefined ? 3 : 1e6;
  if (shader === undefined) return false;
  renderer.material.vertexShader = shader;
  renderer.material.needsUpdate = true;
  return true;
}

/** Width of Spark's textures, splats; they consist of whole lines. */
const TEXTURE_WIDTH = 2048;
const BANDS = ["sh1", "sh2", "sh3a", "sh3b"] as const;

/**
 * Stream a scene into a mesh of Spark (three.js).
 *
 * The mesh can be added to a three.js scene at once. Splats appear as chunks arrive; refinements and SH coefficients
 * replace their rows. Missing rows are transparent, and the others compensate for them (SPEC 8.5) unless `compensate`
 * is false.
 *
 * The upload, in Spark's `ExtSplats`, keeps SPEC 8.6. Spark packs all splats of a picture again before drawing, more
 * coarsely unless its renderer is made with `accumExtSplats`.
 *
 * @param spark - The module `@sparkjsdev/spark`, 2.1 or later.
 *
 * @example
 * ```ts
 * import * as spark from "@sparkjsdev/spark";
 * import { StreamedScene } from "cogsplat";
 * import { streamToSpark } from "cogsplat/spark";
 *
 * world.add(new spark.SparkRenderer({ renderer, accumExtSplats: true }));
 * const { mesh, done } = streamToSpark(await StreamedScene.open(url), spark);
 * world.add(mesh);
 * await done;
 * ```
 */
export function streamToSpark<M extends SparkMesh>(
  scene: StreamedScene,
  spark: SparkModule<M>,
  options: AdapterOptions = {},
): SparkScene<M> {
  const degree = wantedDegree(scene, options);
  const lines = Math.max(1, Math.ceil(scene.info.splats / TEXTURE_WIDTH));
  const arrays = sceneArrays(scene, "spark", degree).map((array) => {
    // Whole lines, because Spark drops partial ones.
    const whole = new Uint32Array(4 * TEXTURE_WIDTH * lines);
    return array.length === whole.length ? (array as Uint32Array<ArrayBuffer>) : whole;
  });
  const [centers, shapes, ...bands] = arrays as [Uint32Array, Uint32Array, ...Uint32Array[]];
  const extra = Object.fromEntries(bands.map((band, i) => [BANDS[i]!, band]));
  const splats = new spark.ExtSplats({ extArrays: [centers, shapes], numSplats: 0, extra });
  const mesh = new spark.SplatMesh({ extSplats: splats });
  mesh.quaternion.set(...axesRotation(scene.info.axes));
  mesh.position.set(...originPosition(scene, options));
  const upload = (rows: number): void => {
    splats.numSplats = rows;
    mesh.numSplats = rows;
    for (const texture of splats.textures) texture.needsUpdate = true;
    for (const name of BANDS) refreshTexture(splats.extra[TEXTURES[name]]);
    mesh.updateVersion();
  };
  const abort = followingAbort(options.signal);
  const done = streamTexels(scene, "spark", { arrays, upload }, options, abort.signal);
  return {
    mesh,
    done,
    dispose(): void {
      abort.abort();
      mesh.dispose();
      splats.dispose();
    },
  };
}

/** Names of the band textures in Spark. */
const TEXTURES = { sh1: "sh1Texture", sh2: "sh2Texture", sh3a: "sh3TextureA", sh3b: "sh3TextureB" } as const;

/** Mark a band texture for upload; it exists once Spark has drawn. */
function refreshTexture(texture: unknown): void {
  const value = (texture as { value?: { needsUpdate: boolean } } | undefined)?.value;
  if (value !== undefined) value.needsUpdate = true;
}
