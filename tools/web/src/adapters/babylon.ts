/**
 * Scenes in Babylon.js: the entry point `cogsplat/babylon`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { FRAGMENT_SHADER, SPLATS_PER_INSTANCE, TEXTURE_WIDTH, VERTEX_SHADER } from "../viewer/shaders.js";
import { axesRotation } from "./axes.js";
import { type AdapterStream, followingAbort, originPosition } from "./row_stream.js";
import { SAMPLERS, type ShadedOptions, ShadedScene, type ShaderTexture, type Uniforms } from "./shaded_scene.js";

export type { AdapterOptions, AdapterStream } from "./row_stream.js";
export type { ShadedOptions } from "./shaded_scene.js";

interface BabylonMatrix {
  readonly m: ArrayLike<number>;
}

/** Part of a `Scene` that the adapter uses. */
export interface BabylonScene {
  readonly useRightHandedSystem: boolean;
  readonly activeCamera: { readonly viewport: { readonly width: number; readonly height: number } } | null;
  getViewMatrix(): BabylonMatrix;
  getProjectionMatrix(): BabylonMatrix;
  getEngine(): { getRenderWidth(): number; getRenderHeight(): number };
}

/** Part of an `Effect` that the adapter uses. */
interface BabylonEffect {
  setInt(name: string, value: number): unknown;
  setFloat(name: string, value: number): unknown;
  setFloat2(name: string, x: number, y: number): unknown;
  setFloat3(name: string, x: number, y: number, z: number): unknown;
  setFloat4(name: string, x: number, y: number, z: number, w: number): unknown;
  setMatrix3x3(name: string, values: Float32Array): unknown;
}

/** Part of a `RawTexture` that the adapter uses. */
export interface BabylonTexture {
  update(data: Uint32Array): void;
  dispose(): void;
}

/** Part of a `Mesh` that the adapter uses. */
export interface BabylonMesh {
  material: unknown;
  isUnIndexed: boolean;
  isPickable: boolean;
  forcedInstanceCount: number;
  rotationQuaternion: unknown;
  readonly scaling: { y: number };
  readonly position: { set(x: number, y: number, z: number): unknown };
  setVerticesData(kind: string, values: Float32Array): unknown;
  getWorldMatrix(): BabylonMatrix;
  dispose(): void;
}

/** Part of a `ShaderMaterial` that the adapter uses. */
export interface BabylonMaterial {
  alphaMode: number;
  backFaceCulling: boolean;
  disableDepthWrite: boolean;
  readonly onBindObservable: { add(callback: (mesh: { getWorldMatrix(): BabylonMatrix }) => void): unknown };
  setTexture(name: string, texture: never): unknown;
  getEffect(): BabylonEffect | null | undefined;
  dispose(): void;
}

/** Classes of `@babylonjs/core` that the adapter instantiates. */
export interface BabylonModule<S extends BabylonScene, M extends BabylonMesh> {
  readonly Mesh: new (name: string, scene: S) => M;
  readonly ShaderMaterial: new (
    name: string,
    scene: S,
    source: { vertexSource: string; fragmentSource: string },
    options: { attributes: string[]; uniforms: string[]; samplers: string[]; needAlphaBlending: boolean },
  ) => BabylonMaterial;
  readonly RawTexture: new (
    data: Uint32Array,
    width: number,
    height: number,
    format: number,
    scene: S,
    mipmaps: boolean,
    invertY: boolean,
    sampling: number,
    type: number,
  ) => BabylonTexture;
  readonly Quaternion: new (x: number, y: number, z: number, w: number) => unknown;
}

/** A scene in Babylon.js. */
export interface BabylonSplats<M extends BabylonMesh> extends AdapterStream {
  /** Mesh in the Babylon.js scene; it fills as chunks arrive. */
  readonly mesh: M;
}

/** Constants of the engine: formats by words of a texel, then a type, a sampling mode and a blending mode. */
const FORMATS = { 1: 8, 2: 9, 4: 11 } as const;
const UNSIGNED_INTEGER = 7;
const NEAREST = 1;
const PREMULTIPLIED_OVER = 8;
/** Uniforms that GLSL declares as int or bool. */
const INTEGERS = new Set(["count", "degree", "antialiased", "compensated", "levelled"]);
/** Uniforms of a picture. */
const OF_PICTURE = [
  ...["count", "rotation", "translation", "cameraPosition", "focal", "viewport", "middle", "depth"],
  ...["trainingPixel", "trainingRest"],
];

/**
 * Stream a scene into a mesh of Babylon.js, drawn by the rules of SPEC 8.7.
 *
 * The mesh can be moved, turned and scaled. Opaque objects hide splats behind them. Cameras are perspective ones.
 * Splats appear as chunks arrive; refinements and SH coefficients replace their rows. Missing rows are transparent, and
 * the others compensate for them (SPEC 8.5) unless `compensate` is false. A worker sorts the rows by depth; where a
 * policy refuses it, slices on this thread do.
 *
 * Splats take 28 bytes each in graphics memory, and 40 for the bands of degree 3. Colours are written as they are, for
 * the screen. The engine's own `GaussianSplattingMesh` would leave out splats whose centre is 1.2 times the picture away
 * from the middle, stretch those near the edge, and cut large ones.
 *
 * @param babylon - The module `@babylonjs/core`, 9 or later, or an object with its four classes.
 * @param world - Scene of Babylon.js that gets the mesh, of either handedness.
 *
 * @example
 * ```ts
 * import { Mesh, Quaternion, RawTexture, ShaderMaterial } from "@babylonjs/core";
 * import { DecoderPool, StreamedScene } from "cogsplat";
 * import { streamToBabylon } from "cogsplat/babylon";
 *
 * const scene = await StreamedScene.open(url, { service: (index) => new DecoderPool(index) });
 * const { mesh, done } = streamToBabylon(scene, { Mesh, Quaternion, RawTexture, ShaderMaterial }, world);
 * await done;
 * ```
 */
export function streamToBabylon<S extends BabylonScene, M extends BabylonMesh>(
  scene: StreamedScene,
  babylon: BabylonModule<S, M>,
  world: S,
  options: ShadedOptions = {},
): BabylonSplats<M> {
  const engine = world.getEngine();
  const shaded = new ShadedScene(scene, options, (names) => {
    for (const { name, data } of shaded.textures) if (names.includes(name)) textures.get(name)!.update(data);
    mesh.forcedInstanceCount = Math.max(1, Math.ceil(shaded.count / SPLATS_PER_INSTANCE));
  });
  const makeTexture = ({ data, words }: ShaderTexture): BabylonTexture => {
    const size = [TEXTURE_WIDTH, shaded.lines] as const;
    return new babylon.RawTexture(data, ...size, FORMATS[words], world, false, false, NEAREST, UNSIGNED_INTEGER);
  };
  const textures = new Map(shaded.textures.map((texture) => [texture.name, makeTexture(texture)]));
  const material = new babylon.ShaderMaterial(
    "cogsplat",
    world,
    { vertexSource: VERTEX_SHADER, fragmentSource: FRAGMENT_SHADER },
    {
      attributes: [],
      uniforms: [...Object.keys(shaded.constants), ...OF_PICTURE],
      samplers: [...SAMPLERS],
      needAlphaBlending: true,
    },
  );
  for (const name of SAMPLERS) material.setTexture(name, (textures.get(name) ?? textures.get("splats")) as never);
  material.alphaMode = PREMULTIPLIED_OVER;
  material.backFaceCulling = false;
  material.disableDepthWrite = true;
  material.onBindObservable.add((bound) => {
    const viewport = world.activeCamera?.viewport ?? { width: 1, height: 1 };
    const size = [engine.getRenderWidth() * viewport.width, engine.getRenderHeight() * viewport.height] as const;
    const matrices = { view: world.getViewMatrix().m, projection: world.getProjectionMatrix().m };
    const picture = shaded.draw(matrices, bound.getWorldMatrix().m, size);
    setUniforms(material.getEffect()!, { ...shaded.constants, ...picture });
  });
  const mesh = new babylon.Mesh("cogsplat", world);
  mesh.setVerticesData("position", cornersOf(scene.info.box));
  mesh.isUnIndexed = true;
  mesh.isPickable = false;
  mesh.forcedInstanceCount = 1;
  mesh.material = material;
  const axes = world.useRightHandedSystem ? "RUB" : "RUF";
  turn(mesh, babylon, scene.info.axes, axes);
  mesh.position.set(...originPosition(scene, options, axes));
  const abort = followingAbort(options.signal);
  return {
    mesh,
    done: shaded.stream(abort.signal),
    dispose(): void {
      abort.abort();
      shaded.close();
      mesh.dispose();
      material.dispose();
      for (const texture of textures.values()) texture.dispose();
    },
  };
}

/** Return positions from which the engine takes the box of the mesh; the shader reads none of them. */
function cornersOf(box: readonly number[]): Float32Array {
  return Float32Array.from({ length: 9 * SPLATS_PER_INSTANCE }, (_, i) => box[(i % 3) + (i % 2 ? 3 : 0)]!);
}

function setUniforms(effect: BabylonEffect, uniforms: Uniforms): void {
  for (const [name, value] of Object.entries(uniforms)) {
    if (INTEGERS.has(name)) effect.setInt(name, Number(value));
    else if (typeof value === "object" && value.length === 9) effect.setMatrix3x3(name, Float32Array.from(value));
    else if (typeof value === "object" && value.length === 4)
      effect.setFloat4(name, value[0]!, value[1]!, value[2]!, value[3]!);
    else if (typeof value === "object" && value.length === 3) effect.setFloat3(name, value[0]!, value[1]!, value[2]!);
    else if (typeof value === "object") effect.setFloat2(name, value[0]!, value[1]!);
    else effect.setFloat(name, Number(value));
  }
}

/** Turn a mesh from the scene's axes to those of the world, which may be a reflection. */
function turn<M extends BabylonMesh>(
  mesh: M,
  { Quaternion }: Pick<BabylonModule<never, M>, "Quaternion">,
  from: string,
  to: string,
): void {
  const opposite: Readonly<Record<string, string>> = { R: "L", L: "R", U: "D", D: "U", F: "B", B: "F" };
  const [x, y, z] = from as unknown as [string, string, string];
  try {
    mesh.rotationQuaternion = new Quaternion(...axesRotation(from, to));
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    mesh.rotationQuaternion = new Quaternion(...axesRotation(`${x}${opposite[y]}${z}`, to));
    mesh.scaling.y = -1;
  }
}
