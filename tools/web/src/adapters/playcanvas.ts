/**
 * Scenes in the PlayCanvas engine: the entry point `cogsplat/playcanvas`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { DEFAULT_RANGES, LOG_SCALE_MAX, LOG_SCALE_MIN, SH_WORDS } from "../scene/packed_splats.js";
import { trainingPixelInView } from "../scene/training_pixel.js";
import { axesRotation } from "./axes.js";
import { PackedRows } from "./packed_rows.js";
import { type PlayCanvasApplication, type PlayCanvasHandle, sortBehindCameras } from "./playcanvas_sorting.js";
import {
  type AdapterOptions,
  type AdapterStream,
  followingAbort,
  originPosition,
  type RowTarget,
  streamRows,
  wantedDegree,
} from "./row_stream.js";
import { editShader, glslFloat, TRAINING_AREA } from "./shader_edits.js";

export type { PlayCanvasApplication, PlayCanvasHandle } from "./playcanvas_sorting.js";
export type { AdapterOptions, AdapterStream } from "./row_stream.js";

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
  readonly PIXELFORMAT_RG32U: number;
  readonly PIXELFORMAT_RGBA32U: number;
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
  readonly graphicsDevice: {
    readonly isWebGPU?: boolean;
    readonly scope: { resolve(name: string): { setValue(value: unknown): unknown } };
  };
  readonly scene: {
    on(name: "prerender:layer", draws: (camera: { readonly viewMatrix: PlayCanvasMatrix }) => void): PlayCanvasHandle;
    readonly gsplat: {
      minPixelSize: number;
      antiAlias: boolean;
      dataFormat: string;
      readonly material: { getShaderChunks(language: "glsl"): PlayCanvasChunks; update(): void };
    };
  };
}

interface PlayCanvasMatrix {
  readonly data: ArrayLike<number>;
}

/** Part of an `Entity` that `drawBySpec` uses. */
export interface PlayCanvasEntity {
  getWorldTransform(): PlayCanvasMatrix;
}

/** Handlers of the last calls of `drawBySpec`, by the scenes of their applications. */
const FOLLOWING = new WeakMap<object, PlayCanvasHandle>();

/**
 * Change PlayCanvas's WebGL shaders to render closer to SPEC 8.7.
 *
 * Gaussians extend to a contribution of 1/255, are as thick as trained, and the projection's Jacobian is clamped to
 * 1.3 times the picture. Splats nearer than the camera's near plane, 0.2 in SPEC 8.7, are hidden. The engine copies
 * splats at 32 bytes each in place of 24. The changes, and the viewpoints of the scene, apply to all splats of the
 * application, and a later call replaces them.
 *
 * The number of sorting keys stays that of the engine (2.23.3, `gsplat-unified-sort-worker`): 2^b + 1, where b is log₂
 * of a quarter of the number of splats, rounded and between 10 and 20. Splats that share a key are drawn in arbitrary
 * order; `leastRows` of `streamToPlayCanvas` raises the number of keys.
 *
 * @param entity - The scene's entity, which may be moved, turned, and scaled alike along all axes.
 * @returns Whether the engine's shaders were changed; those of another version, and of WebGPU, stay as they are.
 *
 * @example
 * ```ts
 * app.start();
 * drawBySpec(pc, app, scene, entity);
 * ```
 */
export function drawBySpec(
  pc: PlayCanvasShaders,
  app: PlayCanvasSettings,
  { info }: Pick<StreamedScene, "info">,
  entity: PlayCanvasEntity,
): boolean {
  const { gsplat } = app.scene;
  FOLLOWING.get(app.scene)?.off();
  FOLLOWING.delete(app.scene);
  gsplat.minPixelSize = 0;
  // The engine's default copies round scales of 8 bits to other 8 bits, and blue to steps of 1/256.
  gsplat.dataFormat = "large";
  const knowsTraining = info.capture.length > 0 && !info.antialiased;
  gsplat.antiAlias = info.antialiased;
  if (app.graphicsDevice.isWebGPU) {
    // An edited GLSL chunk makes the engine translate all of the material's shaders from GLSL, and it draws nothing.
    console.warn('cogsplat: on WebGPU PlayCanvas draws by its own rules; for SPEC 8.7 use deviceTypes: ["webgl2"]');
    return false;
  }
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
    // The engine also draws what lies between the camera and its near plane.
    gsplatCenterVS: [["centerView.z > 0.0", "centerView.z > -camera_params.z"]],
    gsplatCornerVS: [
      ["+ 0.3", knowsTraining ? "+ blur" : `+ ${kernel}`],
      ...(knowsTraining ? trainedThickness(kernel) : []),
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
  gsplat.material.update();
  if (!knowsTraining) return true;
  // The engine then multiplies opacities by the determinant before the filter over that after it.
  gsplat.antiAlias = true;
  const { scope } = app.graphicsDevice;
  const following = app.scene.on("prerender:layer", ({ viewMatrix }) => {
    const pixel = trainingPixelInView(info.capture, viewMatrix.data, entity.getWorldTransform().data);
    scope.resolve("trainingPixel").setValue(pixel.slice(0, 4));
    scope.resolve("trainingRest").setValue(pixel[4]);
  });
  FOLLOWING.set(app.scene, following);
  return true;
}

/** Return edits for the thickness and the filter of each splat from the pixel of training (SPEC 8.7). */
function trainedThickness(kernel: string): readonly (readonly [string, string])[] {
  const covariance = "mat3 cov = transpose(T) * Vrk * T;";
  return [
    [
      "uniform float minPixelSize;",
      `uniform float minPixelSize; ${TRAINING_AREA}
float pixelArea(float focal) { return focal * focal; }
float pixelArea(vec2 focal) { return abs(focal.x * focal.y); }`,
    ],
    [
      covariance,
      `${covariance}
      float share = 0.25 * trainingArea(v) * pixelArea(focal) / (camera_params.w == 1.0 ? 1.0 : dot(v, v));
      float blur = max(0.0, 1.0 - share) / 3.0;
      cov[0][0] += ${kernel} * share; cov[1][1] += ${kernel} * share;`,
    ],
  ];
}

/** Number of distinct splat counts for uploads; at four uploads per second they last four minutes. */
const SPARE_ROWS = 1024;

/** Ranges of the codes, as literals of either shader language. */
const COLOUR_RANGE = `${glslFloat(DEFAULT_RANGES.rgbMax - DEFAULT_RANGES.rgbMin)} + ${glslFloat(DEFAULT_RANGES.rgbMin)}`;
const SCALE_STEP = (LOG_SCALE_MAX - LOG_SCALE_MIN) / 254;
const SCALE_RANGE = `${SCALE_STEP} + ${LOG_SCALE_MIN - SCALE_STEP}`;
const SH_RANGE = glslFloat(DEFAULT_RANGES.shRange);

/** Splat access of the engine's shader, for the words of `PackedSplats`. */
const READ_GLSL = `
uvec4 cogsWords;
vec3 getCenter() {
  cogsWords = loadCogsSplats();
  return vec3(unpackHalf2x16(cogsWords.y), unpackHalf2x16(cogsWords.z & 0xffffu).x);
}
vec3 cogsBytes(uint word) { return vec3((uvec3(word) >> uvec3(0u, 8u, 16u)) & 255u); }
vec4 getColor() { return vec4(cogsBytes(cogsWords.x) / 255.0 * ${COLOUR_RANGE}, float(cogsWords.x >> 24u) / 255.0); }
vec3 getScale() { return exp(cogsBytes(cogsWords.w) * ${SCALE_RANGE}); }
vec4 getRotation() {
  vec2 f = vec2((uvec2(cogsWords.z) >> uvec2(16u, 24u)) & 255u) / 127.5 - 1.0;
  vec3 axis = vec3(f, 1.0 - abs(f.x) - abs(f.y));
  float fold = max(-axis.z, 0.0);
  axis.x += axis.x >= 0.0 ? -fold : fold;
  axis.y += axis.y >= 0.0 ? -fold : fold;
  float turn = float(cogsWords.w >> 24u) * (3.14159265 / 510.0);
  return vec4(cos(turn), normalize(axis) * sin(turn));
}
#if SH_BANDS > 0
float cogsCode(uvec4 words, int at, int bits) {
  int word = at >> 5;
  int shift = at & 31;
  uint value = words[word] >> shift;
  if (shift + bits > 32) value |= words[word + 1] << (32 - shift);
  return float(int(value << (32 - bits)) >> (32 - bits));
}
vec3 cogsCoefficient(uvec4 words, int k, int bits) {
  return vec3(cogsCode(words, 3 * k * bits, bits), cogsCode(words, (3 * k + 1) * bits, bits), cogsCode(words, (3 * k + 2) * bits, bits));
}
void readSHData(out vec3 sh[SH_COEFFS], out float scale) {
  uvec4 words = loadCogsSh1();
  for (int k = 0; k < 3; k++) sh[k] = cogsCoefficient(words, k, 7) / 63.0;
  #if SH_BANDS > 1
    words = loadCogsSh2();
    for (int k = 0; k < 5; k++) sh[3 + k] = cogsCoefficient(words, k, 8) / 127.0;
  #endif
  #if SH_BANDS > 2
    words = loadCogsSh3();
    for (int k = 0; k < 7; k++) sh[8 + k] = cogsCoefficient(words, k, 6) / 31.0;
  #endif
  scale = ${SH_RANGE};
}
#endif
`;
const READ_WGSL = `
var<private> cogsWords: vec4<u32>;
fn getCenter() -> vec3f {
  cogsWords = loadCogsSplats();
  return vec3f(unpack2x16float(cogsWords.y), unpack2x16float(cogsWords.z & 0xffffu).x);
}
fn cogsBytes(word: u32) -> vec3f { return vec3f((vec3<u32>(word) >> vec3<u32>(0u, 8u, 16u)) & vec3<u32>(255u)); }
fn getColor() -> vec4f { return vec4f(cogsBytes(cogsWords.x) / 255.0 * ${COLOUR_RANGE}, f32(cogsWords.x >> 24u) / 255.0); }
fn getScale() -> vec3f { return exp(cogsBytes(cogsWords.w) * ${SCALE_RANGE}); }
fn getRotation() -> vec4f {
  let f = vec2f((vec2<u32>(cogsWords.z) >> vec2<u32>(16u, 24u)) & vec2<u32>(255u)) / 127.5 - 1.0;
  let up = 1.0 - abs(f.x) - abs(f.y);
  let fold = max(-up, 0.0);
  let axis = vec3f(f.x + select(fold, -fold, f.x >= 0.0), f.y + select(fold, -fold, f.y >= 0.0), up);
  let turn = f32(cogsWords.w >> 24u) * (3.14159265 / 510.0);
  return vec4f(cos(turn), normalize(axis) * sin(turn));
}
#if SH_BANDS > 0
fn cogsCode(words: vec4<u32>, at: u32, bits: u32) -> f32 {
  let word = at >> 5u;
  let shift = at & 31u;
  var value = words[word] >> shift;
  if (shift + bits > 32u) { value = value | (words[word + 1u] << (32u - shift)); }
  return f32(bitcast<i32>(value << (32u - bits)) >> (32u - bits));
}
fn cogsCoefficient(words: vec4<u32>, k: u32, bits: u32) -> vec3f {
  return vec3f(cogsCode(words, 3u * k * bits, bits), cogsCode(words, (3u * k + 1u) * bits, bits), cogsCode(words, (3u * k + 2u) * bits, bits));
}
fn readSHData(sh: ptr<function, array<half3, SH_COEFFS>>, scale: ptr<function, f32>) {
  let first = loadCogsSh1();
  for (var k = 0u; k < 3u; k++) { sh[k] = half3(cogsCoefficient(first, k, 7u) / 63.0); }
  #if SH_BANDS > 1
    let second = loadCogsSh2();
    for (var k = 0u; k < 5u; k++) { sh[3u + k] = half3(cogsCoefficient(second, k, 8u) / 127.0); }
  #endif
  #if SH_BANDS > 2
    let third = loadCogsSh3();
    for (var k = 0u; k < 7u; k++) { sh[8u + k] = half3(cogsCoefficient(third, k, 6u) / 31.0); }
  #endif
  *scale = ${SH_RANGE};
}
#endif
`;

/**
 * Stream a scene, with all SH bands, into a resource of PlayCanvas.
 *
 * Splats take 16 bytes each in the textures of the resource, and 40 for the bands of degree 3; the engine copies what it
 * draws into textures of its own.
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
  const { info } = scene;
  const degree = wantedDegree(scene, options);
  const rows = new PackedRows(info.splats, degree);
  // The engine chooses the width of its textures.
  const textures = [rows.words.subarray(0, 4 * info.splats)].concat(
    rows.bands.map((band, i) => band.subarray(0, SH_WORDS[i]! * info.splats)),
  );
  const names = ["cogsSplats", "cogsSh1", "cogsSh2", "cogsSh3"].slice(0, textures.length);
  const streams = names.map((name, i) => ({
    name,
    format: i === 1 ? pc.PIXELFORMAT_RG32U : pc.PIXELFORMAT_RGBA32U,
  }));
  const format = new pc.GSplatFormat(device, streams, { readGLSL: READ_GLSL, readWGSL: READ_WGSL });
  const leastRows = options.leastRows ?? 0;
  const most = Math.max(info.splats, leastRows) + SPARE_ROWS - 1;
  const resource = new pc.GSplatContainer(device, most, format as never);
  // A container draws splats without bands unless its material defines them, and updates view-dependent colour only
  // where its data declares bands.
  resource.configureMaterialDefines = (defines) => defines.set("SH_BANDS", String(degree));
  resource.gsplatData.shBands = degree;
  const { box } = info;
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
  const upload = (count: number): void => {
    names.forEach((name, i) => {
      const texture = resource.getTexture(name)!;
      texture.lock().set(textures[i]!);
      texture.unlock();
    });
    drawn = Math.max(count, leastRows);
    redraw(drawn, true);
  };
  const { application } = options;
  const unfollow =
    application &&
    sortBehindCameras(application, () => {
      if (drawn > 0) redraw(drawn, false);
    });
  const abort = followingAbort(options.signal);
  const target: RowTarget = {
    format: "packed",
    write(update, shifts): void {
      rows.write(update, shifts);
      resource.centers.set(update.packed!.means, 3 * update.firstRow);
    },
    upload,
  };
  const done = streamRows(scene, target, options, abort.signal);
  return {
    resource,
    rotation: axesRotation(info.axes),
    position: originPosition(scene, options),
    done,
    dispose(): void {
      abort.abort();
      unfollow?.();
      resource.destroy();
    },
  };
}
