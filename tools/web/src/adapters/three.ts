/**
 * Scenes in three.js without another library: the entry point `cogsplat/three`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { FRAGMENT_SHADER, SPLATS_PER_INSTANCE, TEXTURE_WIDTH, VERTEX_SHADER } from "../viewer/shaders.js";
import { axesRotation } from "./axes.js";
import { type AdapterStream, followingAbort, originPosition } from "./row_stream.js";
import { SAMPLERS, type ShadedOptions, ShadedScene, type ShaderTexture } from "./shaded_scene.js";

export type { AdapterOptions, AdapterStream } from "./row_stream.js";
export type { ShadedOptions } from "./shaded_scene.js";

/** Part of a `DataTexture` that the adapter uses. */
export interface ThreeTexture {
  internalFormat: string | null;
  needsUpdate: boolean;
  dispose(): void;
}

/** Part of an `InstancedBufferGeometry` that the adapter uses. */
export interface ThreeGeometry {
  instanceCount: number;
  boundingSphere: unknown;
  boundingBox: unknown;
  setDrawRange(start: number, count: number): void;
  dispose(): void;
}

/** Part of a `RawShaderMaterial` that the adapter uses. */
export interface ThreeMaterial {
  dispose(): void;
}

/** Part of a `Mesh` that the adapter uses. */
export interface ThreeMesh {
  readonly quaternion: { set(x: number, y: number, z: number, w: number): unknown };
  readonly position: { set(x: number, y: number, z: number): unknown };
  readonly matrixWorld: ThreeMatrix;
  onBeforeRender: (renderer: never, scene: never, camera: never, ...others: never[]) => void;
}

interface ThreeMatrix {
  readonly elements: ArrayLike<number>;
}

interface ThreeVector4 {
  readonly z: number;
  readonly w: number;
}

interface ThreeRenderer {
  getCurrentViewport(target: ThreeVector4): ThreeVector4;
}

interface ThreeCamera {
  readonly matrixWorldInverse: ThreeMatrix;
  readonly projectionMatrix: ThreeMatrix;
  /** Part of the picture for one eye of a headset. */
  readonly viewport?: ThreeVector4;
}

/** Classes and constants of `three` that the adapter uses. */
export interface ThreeModule<G extends ThreeGeometry, L extends ThreeMaterial, M extends ThreeMesh> {
  readonly DataTexture: new (
    data: Uint32Array<ArrayBuffer>,
    width: number,
    height: number,
    format: never,
    type: never,
  ) => ThreeTexture;
  readonly InstancedBufferGeometry: new () => G;
  readonly RawShaderMaterial: new (parameters: never) => L;
  readonly Mesh: new (geometry: G, material: L) => M;
  readonly Box3: new (min: never, max: never) => { getBoundingSphere(target: never): unknown };
  readonly Sphere: new () => unknown;
  readonly Vector3: new (x: number, y: number, z: number) => unknown;
  readonly Vector4: new () => ThreeVector4;
  readonly RedIntegerFormat: unknown;
  readonly RGIntegerFormat: unknown;
  readonly RGBAIntegerFormat: unknown;
  readonly UnsignedIntType: unknown;
  readonly GLSL3: unknown;
  readonly CustomBlending: unknown;
  readonly OneFactor: unknown;
  readonly OneMinusSrcAlphaFactor: unknown;
  readonly DoubleSide: unknown;
}

/** A scene in three.js. */
export interface ThreeScene<M extends ThreeMesh> extends AdapterStream {
  /** Mesh to add to a three.js scene; it fills as chunks arrive. */
  readonly mesh: M;
}

/** Internal formats by words per texel. */
const FORMATS = {
  1: ["R32UI", "RedIntegerFormat"],
  2: ["RG32UI", "RGIntegerFormat"],
  4: ["RGBA32UI", "RGBAIntegerFormat"],
} as const;
/** Uniforms of a picture, before the first. */
const FIRST_PICTURE = {
  ...{ count: 0, rotation: new Float32Array(9), translation: [0, 0, 0], cameraPosition: [0, 0, 0] },
  ...{ focal: [1, 1], viewport: [1, 1], middle: [0, 0], depth: [0, 0] },
  ...{ trainingPixel: [0, 0, 0, 0], trainingRest: 0 },
};

/**
 * Stream a scene into a mesh of three.js, drawn by the rules of SPEC 8.7.
 *
 * The mesh can be added to a scene at once, moved, turned and scaled. Opaque objects hide splats behind them. Cameras
 * are perspective ones. Splats appear as chunks arrive; refinements and SH coefficients replace
 * their rows. Missing rows are transparent, and the others compensate for them (SPEC 8.5) unless `compensate` is false.
 * A worker sorts the rows by depth; where a policy refuses it, slices on this thread do.
 *
 * Splats take 28 bytes each in graphics memory, and 40 for the bands of degree 3. Colours are written as they are, for
 * the screen.
 *
 * @param three - The module `three`, or an object with the classes and constants of `ThreeModule`.
 *
 * @example
 * ```ts
 * import * as THREE from "three";
 * import { DecoderPool, StreamedScene } from "cogsplat";
 * import { streamToThree } from "cogsplat/three";
 *
 * const scene = await StreamedScene.open(url, { service: (index) => new DecoderPool(index) });
 * const { mesh, done } = streamToThree(scene, THREE);
 * world.add(mesh);
 * await done;
 * ```
 */
export function streamToThree<G extends ThreeGeometry, L extends ThreeMaterial, M extends ThreeMesh>(
  scene: StreamedScene,
  three: ThreeModule<G, L, M>,
  options: ShadedOptions = {},
): ThreeScene<M> {
  const { info } = scene;
  const shaded = new ShadedScene(scene, options, (names) => {
    for (const name of names) textures.get(name)!.needsUpdate = true;
    geometry.instanceCount = Math.ceil(shaded.count / SPLATS_PER_INSTANCE);
  });
  const makeTexture = ({ data, words }: ShaderTexture): ThreeTexture => {
    const [internal, format] = FORMATS[words];
    const type = three.UnsignedIntType as never;
    const texture: ThreeTexture = new three.DataTexture(
      data,
      TEXTURE_WIDTH,
      shaded.lines,
      three[format] as never,
      type,
    );
    texture.internalFormat = internal;
    texture.needsUpdate = true;
    return texture;
  };
  const textures = new Map(shaded.textures.map((texture) => [texture.name, makeTexture(texture)]));
  const samplers = SAMPLERS.map((name) => [name, textures.get(name) ?? textures.get("splats")]);
  const values = { ...Object.fromEntries(samplers), ...shaded.constants, ...FIRST_PICTURE };
  const uniforms = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, { value }]));
  const material = new three.RawShaderMaterial({
    ...{ glslVersion: three.GLSL3, vertexShader: withoutVersion(VERTEX_SHADER) },
    ...{ fragmentShader: withoutVersion(FRAGMENT_SHADER), uniforms },
    ...{ transparent: true, depthTest: true, depthWrite: false, side: three.DoubleSide },
    ...{ blending: three.CustomBlending, blendSrc: three.OneFactor, blendDst: three.OneMinusSrcAlphaFactor },
  } as never);
  const geometry = new three.InstancedBufferGeometry();
  geometry.setDrawRange(0, 3 * SPLATS_PER_INSTANCE);
  geometry.instanceCount = 0;
  const [x0, y0, z0, x1, y1, z1] = info.box as [number, number, number, number, number, number];
  const box = new three.Box3(new three.Vector3(x0, y0, z0) as never, new three.Vector3(x1, y1, z1) as never);
  geometry.boundingBox = box;
  geometry.boundingSphere = box.getBoundingSphere(new three.Sphere() as never);
  const mesh = new three.Mesh(geometry, material);
  mesh.quaternion.set(...axesRotation(info.axes));
  mesh.position.set(...originPosition(scene, options));
  const viewport = new three.Vector4();
  mesh.onBeforeRender = (renderer: ThreeRenderer, _scene: unknown, camera: ThreeCamera): void => {
    const { z: width, w: height } = camera.viewport ?? renderer.getCurrentViewport(viewport);
    const matrices = { view: camera.matrixWorldInverse.elements, projection: camera.projectionMatrix.elements };
    for (const [name, value] of Object.entries(shaded.draw(matrices, mesh.matrixWorld.elements, [width, height]))) {
      uniforms[name]!.value = value;
    }
  };
  const abort = followingAbort(options.signal);
  return {
    mesh,
    done: shaded.stream(abort.signal),
    dispose(): void {
      abort.abort();
      shaded.close();
      for (const texture of textures.values()) texture.dispose();
      geometry.dispose();
      material.dispose();
    },
  };
}

/** three.js writes the version itself, before its own definitions. */
function withoutVersion(shader: string): string {
  return shader.replace("#version 300 es\n", "");
}
