/**
 * Scenes in the PlayCanvas engine: the entry point `cogsplat/playcanvas`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { texelWidths } from "../scene/texels.js";
import { axesRotation } from "./axes.js";
import { type PlayCanvasApplication, sortBehindCameras } from "./playcanvas_sorting.js";
import { editShader, glslFloat } from "./shader_edits.js";
import {
  type AdapterOptions,
  type AdapterStream,
  followingAbort,
  originPosition,
  sceneArrays,
  streamTexels,
  wantedDegree,
} from "./texel_stream.js";

export type { PlayCanvasApplication } from "./playcanvas_sorting.js";
export type { AdapterOptions, AdapterStream } from "./texel_stream.js";

/** Options of a stream into PlayCanvas. */
export interface PlayCanvasOptions extends AdapterOptions {
  /**
   * Minimum number of rows of the resource; rows beyond the scene's splats are transparent. No minimum by default.
   *
   * In WebGL the engine sorts by at least 1,025 keys, otherwise a quarter of the number of rows. With few keys many
   * splats share one; with 65,536 rows there are 16,385 keys.
   */
  readonly leastRows?: number;
  /**
   * Application that shows the scene. If given, the splats are sorted once more when its cameras have come to rest,
   * because PlayCanvas 2.23.3 drops a view that arrives during a sort.
   */
  readonly application?: PlayCanvasApplication;
}

/** Part of a texture that the adapter uses. */
export interface PlayCanvasTexture {
  lock(): { set(values: ArrayLike<number>): void };
  unlock(): void;
}

/** Part of the engine's `GSplatContainer` that the adapter uses. */
export interface PlayCanvasContainer {
  readonly centers: Float32Array;
  readonly gsplatData: { shBands?: number };
  readonly aabb: { readonly center: Settable; readonly halfExtents: Settable };
  getTexture(name: string): PlayCanvasTexture | null;
  update(splats: number, centersUpdated?: boolean): void;
  configureMaterialDefines(defines: Map<string, string>): void;
  destroy(): void;
}

interface Settable {
  set(x: number, y: number, z: number): unknown;
}

/** Part of the module `playcanvas` that the adapter uses. */
export interface PlayCanvasModule<D, C extends PlayCanvasContainer> {
  readonly GSplatFormat: new (
    device: D,
    streams: { name: string; format: number }[],
    options: { readGLSL: string; readWGSL: string },
  ) => unknown;
  readonly GSplatContainer: new (device: D, maxSplats: number, format: never) => C;
  readonly PIXELFORMAT_RGBA16F: number;
  readonly PIXELFORMAT_RGBA32U: number;
  readonly PIXELFORMAT_R32U: number;
}

/** A scene in PlayCanvas. */
export interface PlayCanvasScene<C extends PlayCanvasContainer> extends AdapterStream {
  /** The resource of a component: `entity.addComponent("gsplat", { resource })`. */
  readonly resource: C;
  /** Rotation x y z w of the entity, from the scene's axes to the engine's. */
  readonly rotation: readonly [number, number, number, number];
  /** Position of the entity. */
  readonly position: readonly [number, number, number];
}

/** Shader chunks by name. */
export interface PlayCanvasChunks {
  get(name: string): string | undefined;
  set(name: string, text: string): unknown;
}

/** Part of the module `playcanvas` that `drawBySpec` uses. */
export interface PlayCanvasShaders {
  readonly ShaderChunks: { get(device: never, language: "glsl"): PlayCanvasChunks };
}

/** Settings of an application that `drawBySpec` changes. */
export interface PlayCanvasSettings {
  readonly graphicsDevice: unknown;
  readonly scene: {
    readonly gsplat: {
      minPixelSize: number;
      antiAlias: boolean;
      readonly material: { getShaderChunks(language: "glsl"): PlayCanvasChunks };
    };
  };
}

/**
 * Change PlayCanvas's WebGL shaders to render closer to SPEC 8.7.
 *
 * Gaussians extend to a contribution of 1/255, the scene's kernel is used, and the projection's Jacobian is clamped to
 * 1.3 times the picture. The changes apply to all splats of the application. Call it before the first picture.
 *
 * The number of sorting keys stays that of the engine (2.23.3, `gsplat-unified-sort-worker`): 2^b + 1, where b is log₂
 * of a quarter of the number of splats, rounded and between 10 and 20. Splats that share a key are drawn in arbitrary
 * order; `leastRows` of `streamToPlayCanvas` raises the number of keys.
 *
 * @returns Whether the engine's shaders were recognised; shaders of another version stay unchanged.
 *
 * @example
 * ```ts
 * app.start();
 * drawBySpec(pc, app, scene);
 * ```
 */
export function drawBySpec(
  pc: PlayCanvasShaders,
  app: PlayCanvasSettings,
  { info }: Pick<StreamedScene, "info">,
): boolean {
  const { gsplat } = app.scene;
  gsplat.minPixelSize = 0;
  gsplat.antiAlias = info.antialiased;
  const own = pc.ShaderChunks.get(app.graphicsDevice as never, "glsl");
  // The engine works in half pixels, where variances are four times as large.
  const kernel = glslFloat(4 * info.kernelPx);
  const edits = {
    gsplatPS: [
      ["normExp(A) * gaussianColor.a", "min(0.99, exp(A * -4.0) * gaussianColor.a)"],
      ["if (A > 1.0)", "if (A > 1.4)"],
    ],
    gsplatCommonVS: [
      [
        "float clip = min(1.0, sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5);",
        "float clip = sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5;",
      ],
    ],
    gsplatCornerVS: [
      ["+ 0.3", `+ ${kernel}`],
      [
        "vec2 J2 = -J1 / vp.z * vp.xy;",
        "vec2 edge = 1.3 / vec2(center.projMat00, abs(center.projMat11)); vec2 J2 = -J1 * clamp(vp.xy / vp.z, -edge, edge);",
      ],
      ["min(1024.0, min(viewport_size.x, viewport_size.y))", "1e6"],
    ],
  } as const;
  const edited = Object.entries(edits).map(([name, pairs]) => [name, editShader(own.get(name) ?? "", pairs)] as const);
  if (edited.some(([, text]) => text === undefined)) return false;
  for (const [name, text] of edited) gsplat.material.getShaderChunks("glsl").set(name, text!);
  return true;
}

/** Number of distinct splat counts for uploads; at four uploads per second they last four minutes. */
const SPARE_ROWS = 1024;

/** Splat access of the engine's shader; its code for uncompressed splats reads the bands. */
const READ_GLSL = `
uint cogsRotation;
vec4 cogsScale;
vec3 getCenter() {
  uvec4 transform = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return uintBitsToFloat(transform.xyz);
}
vec4 getColor() { return loadDcColor(); }
vec3 getScale() { return cogsScale.xyz; }
vec4 getRotation() {
  vec3 s = (vec3((uvec3(cogsRotation) >> uvec3(0u, 10u, 20u)) & 1023u) / 511.5 - 1.0) * 0.70710678;
  float rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  uint largest = cogsRotation >> 30u;
  if (largest == 0u) return vec4(rest, s);
  if (largest == 1u) return vec4(s.x, rest, s.yz);
  return largest == 2u ? vec4(s.xy, rest, s.z) : vec4(s, rest);
}
#include "gsplatUncompressedSHVS"
`;
const READ_WGSL = `
var<private> cogsRotation: u32;
var<private> cogsScale: vec4f;
fn getCenter() -> vec3f {
  let transform: vec4<u32> = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return bitcast<vec3f>(transform.xyz);
}
fn getColor() -> vec4f { return loadDcColor(); }
fn getScale() -> vec3f { return cogsScale.xyz; }
fn getRotation() -> vec4f {
  let s = (vec3f((vec3u(cogsRotation) >> vec3u(0u, 10u, 20u)) & vec3u(1023u)) / 511.5 - 1.0) * 0.70710678;
  let rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  let largest = cogsRotation >> 30u;
  if (largest == 0u) { return vec4f(rest, s); }
  if (largest == 1u) { return vec4f(s.x, rest, s.yz); }
  if (largest == 2u) { return vec4f(s.xy, rest, s.z); }
  return vec4f(s, rest);
}
#include "gsplatUncompressedSHVS"
`;

/**
 * Stream a scene, with all SH bands, into a resource of PlayCanvas.
 *
 * @param pc - The module `playcanvas`, 2.23 or a later 2.
 * @param device - Graphics device of the application.
 *
 * @example
 * ```ts
 * import * as pc from "playcanvas";
 * import { StreamedScene } from "cogsplat";
 * import { streamToPlayCanvas } from "cogsplat/playcanvas";
 *
 * const { resource, rotation, position, done } = streamToPlayCanvas(await StreamedScene.open(url), pc, app.graphicsDevice);
 * const entity = new pc.Entity();
 * entity.addComponent("gsplat", { resource });
 * entity.setLocalRotation(...rotation);
 * entity.setLocalPosition(...position);
 * app.root.addChild(entity);
 * await done;
 * ```
 */
export function streamToPlayCanvas<D, C extends PlayCanvasContainer>(
  scene: StreamedScene,
  pc: PlayCanvasModule<D, C>,
  device: D,
  options: PlayCanvasOptions = {},
): PlayCanvasScene<C> {
  const degree = wantedDegree(scene, options);
  const widths = texelWidths("playcanvas", degree);
  const arrays = sceneArrays(scene, "playcanvas", degree);
  const streams = widths.map(({ name, width, bytes }) => ({
    name,
    format: bytes === 2 ? pc.PIXELFORMAT_RGBA16F : width === 1 ? pc.PIXELFORMAT_R32U : pc.PIXELFORMAT_RGBA32U,
  }));
  const format = new pc.GSplatFormat(device, streams, { readGLSL: READ_GLSL, readWGSL: READ_WGSL });
  const leastRows = options.leastRows ?? 0;
  const most = Math.max(scene.info.splats, leastRows) + SPARE_ROWS - 1;
  const resource = new pc.GSplatContainer(device, most, format as never);
  // A container draws splats without bands unless its material defines them, and updates view-dependent colour only
  // where its data declares bands.
  resource.configureMaterialDefines = (defines) => defines.set("SH_BANDS", String(degree));
  resource.gsplatData.shBands = degree;
  const { box } = scene.info;
  const [center, half] = [
    [0, 1, 2].map((i) => (box[i]! + box[i + 3]!) / 2),
    [0, 1, 2].map((i) => (box[i + 3]! - box[i]!) / 2),
  ];
  resource.aabb.center.set(center[0]!, center[1]!, center[2]!);
  resource.aabb.halfExtents.set(half[0]!, half[1]!, half[2]!);
  // Transparent rows are sorted too, and the range of the engine's keys is the bounding box.
  for (let at = 0; at < 3 * most; at++) resource.centers[at] = center[at % 3]!;
  resource.update(0);
  // The engine copies the textures into its own only when the number of splats has changed since its last frame. The
  // number therefore changes with every upload, by transparent rows.
  let uploads = 0;
  const redraw = (rows: number, centersUpdated: boolean): void =>
    resource.update(rows + (uploads++ % SPARE_ROWS), centersUpdated);
  let drawn = 0;
  const transformA = arrays[1]!;
  const means = new Float32Array(transformA.buffer, transformA.byteOffset, transformA.length);
  const upload = (rows: number): void => {
    widths.forEach(({ name }, i) => {
      const texture = resource.getTexture(name)!;
      texture.lock().set(arrays[i]!);
      texture.unlock();
    });
    const { centers } = resource;
    for (let row = 0; row < rows; row++) {
      for (let axis = 0; axis < 3; axis++) centers[3 * row + axis] = means[4 * row + axis]!;
    }
    drawn = Math.max(rows, leastRows);
    redraw(drawn, true);
  };
  const { application } = options;
  const unfollow =
    application &&
    sortBehindCameras(application, () => {
      if (drawn > 0) redraw(drawn, false);
    });
  const abort = followingAbort(options.signal);
  const done = streamTexels(scene, "playcanvas", { arrays, upload }, options, abort.signal);
  return {
    resource,
    rotation: axesRotation(scene.info.axes),
    position: originPosition(scene, options),
    done,
    dispose(): void {
      abort.abort();
      unfollow?.();
      resource.destroy();
    },
  };
}
