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
  ownAbort,
  placeOf,
  sceneArrays,
  streamTexels,
  wantedDegree,
} from "./texel_stream.js";

export type { AdapterOptions, AdapterStream } from "./texel_stream.js";

/** What the adapter uses of Spark's `ExtSplats`. */
export interface SparkExtSplats {
  numSplats: number;
  readonly textures: readonly { needsUpdate: boolean }[];
  readonly extra: Record<string, unknown>;
  dispose(): void;
}

/** What the adapter uses of Spark's `SplatMesh`. */
export interface SparkMesh {
  numSplats: number;
  readonly quaternion: { set(x: number, y: number, z: number, w: number): unknown };
  readonly position: { set(x: number, y: number, z: number): unknown };
  updateVersion(): void;
  dispose(): void;
}

/** The two classes of `@sparkjsdev/spark` that the adapter makes objects of. */
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
  /** Add it to a three.js scene; it fills as chunks arrive. */
  readonly mesh: M;
}

/** What `drawBySpec` sets of Spark's `SparkRenderer`. */
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

/** A splat reaches to where it adds 1/255 (SPEC 8.7). */
const ALPHA_MIN = 1 / 255;
/** The Jacobian of the projection is that of a point within 1.3 times the picture (SPEC 8.7), which Spark leaves out. */
const CLAMPED_JACOBIAN = [
  [
    "vec2 J2 = -(J1 * viewCenter.xy) * invZ;",
    "vec2 edge = 1.3 * 0.5 * scaledRenderSize / focal; vec2 J2 = J1 * clamp(-viewCenter.xy * invZ, -edge, edge);",
  ],
] as const;

/**
 * Have Spark draw by the rules of SPEC 8.7: sorted by depth, with the scene's kernel, every splat to where it adds 1/255.
 *
 * Call it before the first picture. A renderer has one kernel for all of its scenes. In a version of Spark whose shader is
 * not known, splats that are centred far beside the picture are left out instead, because they would fill it.
 *
 * @param renderer - A `SparkRenderer`, made with `accumExtSplats: true`.
 * @returns Whether all rules are kept.
 *
 * @example
 * ```ts
 * const renderer = new spark.SparkRenderer({ renderer: webgl, accumExtSplats: true });
 * drawBySpec(renderer, scene);
 * world.add(renderer);
 * ```
 */
export function drawBySpec(renderer: SparkSettings, { info }: Pick<StreamedScene, "info">): boolean {
  // What is added before Spark compares determinants leaves opacities as they are.
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

/** Spark's textures are so many splats wide, and whole lines of them are made. */
const TEXTURE_WIDTH = 2048;
const BANDS = ["sh1", "sh2", "sh3a", "sh3b"] as const;

/**
 * Stream a scene into a mesh of Spark (three.js).
 *
 * The mesh can be added to a three.js scene at once; splats appear as chunks arrive, and get their view-dependent
 * colour and finer values in place. Rows that have not come are fully transparent; those that are there make up for
 * them (SPEC 8.5) unless `compensate` is false.
 *
 * The splats keep SPEC 8.6 as they are uploaded, in Spark's `ExtSplats`. Spark packs all splats of a picture once more
 * before it draws them, coarser unless its renderer is made with `accumExtSplats`.
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
    // Whole lines, because Spark leaves out those that are not.
    const whole = new Uint32Array(4 * TEXTURE_WIDTH * lines);
    return array.length === whole.length ? (array as Uint32Array<ArrayBuffer>) : whole;
  });
  const [centers, shapes, ...bands] = arrays as [Uint32Array, Uint32Array, ...Uint32Array[]];
  const extra = Object.fromEntries(bands.map((band, i) => [BANDS[i]!, band]));
  const splats = new spark.ExtSplats({ extArrays: [centers, shapes], numSplats: 0, extra });
  const mesh = new spark.SplatMesh({ extSplats: splats });
  mesh.quaternion.set(...axesRotation(scene.info.axes));
  mesh.position.set(...placeOf(scene, options));
  const upload = (rows: number): void => {
    splats.numSplats = rows;
    mesh.numSplats = rows;
    for (const texture of splats.textures) texture.needsUpdate = true;
    for (const name of BANDS) refreshTexture(splats.extra[TEXTURES[name]]);
    mesh.updateVersion();
  };
  const abort = ownAbort(options.signal);
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

/** Where Spark keeps the texture of each band. */
const TEXTURES = { sh1: "sh1Texture", sh2: "sh2Texture", sh3a: "sh3TextureA", sh3b: "sh3TextureB" } as const;

/** A texture of a band exists once Spark has drawn; it is uploaded again only where it is told to. */
function refreshTexture(texture: unknown): void {
  const value = (texture as { value?: { needsUpdate: boolean } } | undefined)?.value;
  if (value !== undefined) value.needsUpdate = true;
}
