/**
 * Scenes in Spark, splats for three.js: the entry point `cogsplat/spark`.
 *
 * @packageDocumentation
 */
import type { Viewpoint } from "../container/root.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
import { DEFAULT_RANGES, LOG_SCALE_MAX, LOG_SCALE_MIN } from "../scene/packed_splats.js";
import { trainingPixelInView } from "../scene/training_pixel.js";
import { axesRotation } from "./axes.js";
import { PackedRows } from "./packed_rows.js";
import {
  type AdapterOptions,
  type AdapterStream,
  followingAbort,
  originPosition,
  type RowTarget,
  streamRows,
  wantedDegree,
} from "./row_stream.js";
import { editShader, TRAINING_AREA } from "./shader_edits.js";

export type { AdapterOptions, AdapterStream } from "./row_stream.js";

/** Part of Spark's `PackedSplats` that the adapter uses. */
export interface SparkSplats {
  numSplats: number;
  needsUpdate: boolean;
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

interface SparkMatrix {
  readonly elements: ArrayLike<number>;
}

/** Classes of `@sparkjsdev/spark` that the adapter instantiates. */
export interface SparkModule {
  readonly PackedSplats: new (options: never) => SparkSplats;
  readonly SplatMesh: new (options: never) => SparkMesh;
}

/** A scene in Spark. */
export interface SparkScene<M extends SparkMesh> extends AdapterStream {
  /** Mesh to add to a three.js scene; it fills as chunks arrive. */
  readonly mesh: M;
}

/** Settings of Spark's `SparkRenderer` that `drawBySpec` changes. */
export interface SparkSettings {
  readonly material: {
    vertexShader: string;
    needsUpdate: boolean;
    readonly uniforms: Record<string, { value: unknown }>;
  };
  preBlurAmount: number;
  blurAmount: number;
  sortRadial: boolean;
  maxStdDev: number;
  minAlpha: number;
  maxPixelRadius: number;
  clipXY: number;
  onBeforeRender(
    renderer: never,
    scene: never,
    camera: { readonly matrixWorldInverse: SparkMatrix },
    ...others: never[]
  ): void;
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
/** Thickness and filter of each splat from the pixel of training (SPEC 8.7). */
const TRAINED_THICKNESS = [
  ["uniform float preBlurAmount;", `uniform float preBlurAmount; ${TRAINING_AREA}`],
  [
    "a += preBlurAmount;",
    "float share = trainingArea(viewCenter) * focal.x * focal.y / (isOrthographic ? 1.0 : dot(viewCenter, viewCenter)); a += preBlurAmount * share;",
  ],
  ["d += preBlurAmount;", "d += preBlurAmount * share;"],
  ["float fullBlurAmount = blurAmount;", "float fullBlurAmount = max(0.0, 1.0 - share) / 12.0;"],
  ["clamp(sqr(focusRadius), blurAmount,", "clamp(sqr(focusRadius), fullBlurAmount,"],
] as const;

/** What `drawBySpec` was called with last for a renderer, and the renderer's own shader. */
interface SparkCall {
  readonly ownShader: string;
  readonly capture: readonly Viewpoint[];
  readonly mesh: { readonly matrixWorld: SparkMatrix };
}

const CALLS = new WeakMap<SparkSettings, SparkCall>();

/**
 * Make Spark draw by SPEC 8.7: sorted by depth, as thick as trained, with extents to a contribution of 1/255.
 *
 * A renderer has one kernel, and the viewpoints of one scene, for all of its scenes: those of the last call.
 * In a version of Spark with an unknown shader, splats have the kernel at every size, and those centred far outside the
 * picture are hidden, because they would fill it.
 *
 * @param renderer - A `SparkRenderer`, made with `accumExtSplats: true`.
 * @param mesh - The scene's mesh, which may be moved, turned, and scaled alike along all axes.
 * @returns Whether all rules apply.
 *
 * @example
 * ```ts
 * const renderer = new spark.SparkRenderer({ renderer: webgl, accumExtSplats: true });
 * const { mesh, done } = streamToSpark(scene, spark);
 * drawBySpec(renderer, scene, mesh);
 * world.add(renderer, mesh);
 * ```
 */
export function drawBySpec(
  renderer: SparkSettings,
  { info }: Pick<StreamedScene, "info">,
  mesh: { readonly matrixWorld: SparkMatrix },
): boolean {
  // A kernel added before Spark compares determinants leaves opacities unchanged.
  renderer.preBlurAmount = info.antialiased ? 0 : info.kernelPx;
  renderer.blurAmount = info.antialiased ? info.kernelPx : 0;
  renderer.sortRadial = false;
  renderer.maxStdDev = Math.sqrt(2 * Math.log(1 / ALPHA_MIN));
  renderer.minAlpha = ALPHA_MIN;
  renderer.maxPixelRadius = 1e6;
  const knowsTraining = info.capture.length > 0 && !info.antialiased;
  const edits = knowsTraining ? [...CLAMPED_JACOBIAN, ...TRAINED_THICKNESS] : CLAMPED_JACOBIAN;
  const last = CALLS.get(renderer);
  const ownShader = last?.ownShader ?? renderer.material.vertexShader;
  CALLS.set(renderer, { ownShader, capture: knowsTraining ? info.capture : [], mesh });
  const shader = editShader(ownShader, edits);
  renderer.clipXY = shader === undefined ? 3 : 1e6;
  renderer.material.vertexShader = shader ?? ownShader;
  renderer.material.needsUpdate = true;
  if (last === undefined) followCamera(renderer);
  return shader !== undefined;
}

/** Give the shader the pixel of training for each picture's camera. */
function followCamera(renderer: SparkSettings): void {
  const { onBeforeRender } = renderer;
  const [trainingPixel, trainingRest] = [{ value: [0, 0, 0, 0] }, { value: 0 }];
  Object.assign(renderer.material.uniforms, { trainingPixel, trainingRest });
  renderer.onBeforeRender = (webgl, world, camera, ...others) => {
    onBeforeRender.call(renderer, webgl, world, camera, ...others);
    const { capture, mesh } = CALLS.get(renderer)!;
    if (capture.length === 0) return;
    const pixel = trainingPixelInView(capture, camera.matrixWorldInverse.elements, mesh.matrixWorld.elements);
    trainingPixel.value = pixel.slice(0, 4);
    trainingRest.value = pixel[4];
  };
}

const BANDS = ["sh1", "sh2", "sh3"] as const;

/**
 * Stream a scene into a mesh of Spark (three.js).
 *
 * The mesh can be added to a three.js scene at once. Splats appear as chunks arrive; refinements and SH coefficients
 * replace their rows. Missing rows are transparent, and the others compensate for them (SPEC 8.5) unless `compensate`
 * is false.
 *
 * The splats are Spark's `PackedSplats`, 16 bytes each and 40 for the bands of degree 3. Spark packs all splats of a
 * picture again before drawing, more coarsely unless its renderer is made with `accumExtSplats`.
 *
 * @param spark - The module `@sparkjsdev/spark`, 2.2 or later.
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
export function streamToSpark<K extends SparkModule>(
  scene: StreamedScene,
  spark: K,
  options: AdapterOptions = {},
): SparkScene<InstanceType<K["SplatMesh"]>> {
  // Whole lines, because Spark drops partial ones.
  const rows = new PackedRows(scene.info.splats, wantedDegree(scene, options));
  const { rgbMin, rgbMax, shRange } = DEFAULT_RANGES;
  const splatEncoding = {
    ...{ rgbMin, rgbMax, lnScaleMin: LOG_SCALE_MIN, lnScaleMax: LOG_SCALE_MAX },
    ...{ sh1Max: shRange, sh2Max: shRange, sh3Max: shRange },
  };
  const splats = new spark.PackedSplats({
    packedArray: rows.words,
    numSplats: 0,
    extra: Object.fromEntries(rows.bands.map((band, i) => [BANDS[i]!, band])),
    splatEncoding,
  } as never);
  // The mesh would replace the encoding of its splats by a default.
  const mesh = new spark.SplatMesh({ packedSplats: splats, splatEncoding } as never) as InstanceType<K["SplatMesh"]>;
  mesh.quaternion.set(...axesRotation(scene.info.axes));
  mesh.position.set(...originPosition(scene, options));
  const target: RowTarget = {
    format: "packed",
    write: (update, shifts) => rows.write(update, shifts),
    upload(count: number): void {
      splats.numSplats = count;
      mesh.numSplats = count;
      splats.needsUpdate = true;
      for (const name of BANDS) refreshTexture(splats.extra[`${name}Texture`]);
      mesh.updateVersion();
    },
  };
  const abort = followingAbort(options.signal);
  const done = streamRows(scene, target, options, abort.signal);
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

/** Mark a band texture for upload; it exists once Spark has drawn. */
function refreshTexture(texture: unknown): void {
  const value = (texture as { value?: { needsUpdate: boolean } } | undefined)?.value;
  if (value !== undefined) value.needsUpdate = true;
}
