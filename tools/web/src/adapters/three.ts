/**
 * Scenes in three.js without another library: the entry point `cogsplat/three`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { DEFAULT_RANGES } from "../scene/packed_splats.js";
import { DepthSorter } from "../viewer/depth_sorter.js";
import { FRAGMENT_SHADER, SPLATS_PER_INSTANCE, VERTEX_SHADER } from "../viewer/shaders.js";
import { failureText, startsText, TEXT_ADDRESS } from "../workers/worker_start.js";
import { axesRotation } from "./axes.js";
import { PackedRows, TEXTURE_WIDTH } from "./packed_rows.js";
import {
  type AdapterOptions,
  type AdapterStream,
  followingAbort,
  originPosition,
  type RowTarget,
  streamRows,
  wantedDegree,
} from "./row_stream.js";

export type { AdapterOptions, AdapterStream } from "./row_stream.js";

/** Options of a stream into three.js. */
export interface ThreeOptions extends AdapterOptions {
  /** Called when a new picture is needed, for pages that do not draw all the time. */
  readonly onChange?: () => void;
}

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
  readonly uniforms: Record<string, { value: unknown }>;
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

/** Program of the sorting worker, which the bundle defines (`scripts/bundle.mjs`). */
declare const SORT_TEXT: string | undefined;

/** Internal formats by words per texel. */
const FORMATS = {
  1: ["R32UI", "RedIntegerFormat"],
  2: ["RG32UI", "RGIntegerFormat"],
  4: ["RGBA32UI", "RGBAIntegerFormat"],
} as const;
/** Cosine of the angle by which a view may turn before rows are sorted again: 0.05 degrees. */
const SAME_DIRECTION = 1 - 4e-7;

/**
 * Stream a scene into a mesh of three.js, drawn by the rules of SPEC 8.7.
 *
 * The mesh can be added to a scene at once, moved, turned and scaled. Opaque objects hide splats behind them. Cameras
 * are perspective ones. Splats appear as chunks arrive; refinements and SH coefficients replace
 * their rows. Missing rows are transparent, and the others compensate for them (SPEC 8.5) unless `compensate` is false.
 * A worker sorts the rows by depth; where a policy refuses it, slices on this thread do.
 *
 * Splats take 20 bytes each in graphics memory, and 40 for the bands of degree 3. Colours are written as they are, for
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
  options: ThreeOptions = {},
): ThreeScene<M> {
  const { info } = scene;
  const degree = wantedDegree(scene, options);
  const rows = new PackedRows(info.splats, degree);
  const order = new Uint32Array(rows.lines * TEXTURE_WIDTH);
  const makeTexture = (data: Uint32Array<ArrayBuffer>, words: 1 | 2 | 4): ThreeTexture => {
    const [internal, format] = FORMATS[words];
    const texture: ThreeTexture = new three.DataTexture(
      data,
      TEXTURE_WIDTH,
      rows.lines,
      three[format] as never,
      three.UnsignedIntType as never,
    );
    texture.internalFormat = internal;
    texture.needsUpdate = true;
    return texture;
  };
  const textures = {
    splats: makeTexture(rows.words, 4),
    order: makeTexture(order, 1),
    ...Object.fromEntries(rows.bands.map((band, i) => [`sh${i + 1}`, makeTexture(band, i === 0 ? 2 : 4)])),
  };
  const material = new three.RawShaderMaterial({
    ...{ glslVersion: three.GLSL3, vertexShader: withoutVersion(VERTEX_SHADER) },
    ...{ fragmentShader: withoutVersion(FRAGMENT_SHADER), uniforms: uniformsOf(scene, degree, textures) },
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

  const { uniforms } = material;
  const changed = (): void => options.onChange?.();
  const sorting = new SortedRows(rows, (sorted, count) => {
    order.set(sorted.subarray(0, count));
    textures.order.needsUpdate = true;
    uniforms.count!.value = count;
    geometry.instanceCount = Math.ceil(count / SPLATS_PER_INSTANCE);
    changed();
  });
  const viewport = new three.Vector4();
  mesh.onBeforeRender = (renderer: ThreeRenderer, _scene: unknown, camera: ThreeCamera): void => {
    const { z: width, w: height } = camera.viewport ?? renderer.getCurrentViewport(viewport);
    const pose = poseOf(camera, mesh.matrixWorld);
    for (const [name, value] of Object.entries({ ...pose.uniforms, viewport: [width, height] })) {
      uniforms[name]!.value = value;
    }
    uniforms.focal!.value = [(pose.focal[0] * width) / 2, (pose.focal[1] * height) / 2];
    sorting.look(pose.forward);
  };

  const target: RowTarget = {
    format: "packed",
    write(update, shifts): void {
      rows.write(update, shifts);
      sorting.add(update.firstRow, update.packed!.words);
    },
    upload(count: number): void {
      for (const texture of Object.values(textures)) texture.needsUpdate = true;
      sorting.show(count);
      changed();
    },
  };
  const abort = followingAbort(options.signal);
  const done = streamRows(scene, target, options, abort.signal);
  return {
    mesh,
    done,
    dispose(): void {
      abort.abort();
      sorting.close();
      for (const texture of Object.values(textures)) texture.dispose();
      geometry.dispose();
      material.dispose();
    },
  };
}

/** three.js writes the version itself, before its own definitions. */
function withoutVersion(shader: string): string {
  return shader.replace("#version 300 es\n", "");
}

function uniformsOf(
  { info }: StreamedScene,
  degree: number,
  textures: Record<string, ThreeTexture>,
): Record<string, { value: unknown }> {
  const { rgbMin, rgbMax, shRange } = DEFAULT_RANGES;
  const { splats } = textures;
  // Textures that a degree lacks are declared and not read.
  const samplers = { sh1: splats, sh2: splats, sh3: splats, shifts: splats, levels: splats, ...textures };
  const values = {
    ...{
      ...samplers,
      degree,
      kernel: info.kernelPx,
      antialiased: info.antialiased,
      rgbRange: [rgbMin, rgbMax],
      shRange,
    },
    ...{
      compensated: false,
      levelled: false,
      between: 0,
      count: 0,
      rotation: new Float32Array(9),
      translation: [0, 0, 0],
    },
    ...{ cameraPosition: [0, 0, 0], focal: [1, 1], viewport: [1, 1], middle: [0, 0], depth: [0, 0] },
  };
  return Object.fromEntries(Object.entries(values).map(([name, value]) => [name, { value }]));
}

interface MeshPose {
  readonly uniforms: Readonly<
    Record<"rotation" | "translation" | "cameraPosition" | "middle" | "depth", ArrayLike<number>>
  >;
  /** Focal lengths in halves of the picture. */
  readonly focal: readonly [number, number];
  /** Direction of view in the space of the means. */
  readonly forward: readonly number[];
}

/** Return where a camera sees a mesh. */
export function poseOf(camera: ThreeCamera, matrixWorld: ThreeMatrix): MeshPose {
  const [v, m, p] = [camera.matrixWorldInverse.elements, matrixWorld.elements, camera.projectionMatrix.elements];
  // Rows of diag(1, -1, -1)·V·M: x right, y down, z forward.
  const row = (i: number): number[] =>
    [0, 1, 2, 3].map((j) => {
      const sum = [0, 1, 2, 3].reduce((part, k) => part + v[4 * k + i]! * m[4 * j + k]!, 0);
      return i === 0 ? sum : -sum;
    });
  const [x, y, z] = [row(0), row(1), row(2)] as [number[], number[], number[]];
  const rotation = [0, 1, 2].flatMap((j) => [x[j]!, y[j]!, z[j]!]);
  const translation = [x[3]!, y[3]!, z[3]!];
  const size = Math.hypot(z[0]!, z[1]!, z[2]!);
  return {
    uniforms: {
      ...{ rotation, translation, cameraPosition: solve(x, y, z) },
      middle: [-p[8]!, -p[9]!],
      depth: [-p[10]!, p[14]!],
    },
    focal: [p[0]!, p[5]!],
    forward: z.slice(0, 3).map((value) => value / size),
  };
}

/** Return the point that an affine map of three rows of four numbers takes to the origin. */
function solve(x: readonly number[], y: readonly number[], z: readonly number[]): number[] {
  const cross = (a: readonly number[], b: readonly number[]): number[] => [
    a[1]! * b[2]! - a[2]! * b[1]!,
    a[2]! * b[0]! - a[0]! * b[2]!,
    a[0]! * b[1]! - a[1]! * b[0]!,
  ];
  const [yz, zx, xy] = [cross(y, z), cross(z, x), cross(x, y)];
  const determinant = x[0]! * yz[0]! + x[1]! * yz[1]! + x[2]! * yz[2]!;
  return [0, 1, 2].map((i) => -(x[3]! * yz[i]! + y[3]! * zx[i]! + z[3]! * xy[i]!) / determinant);
}

/** Rows sorted by depth in a worker, or on this thread where it cannot be started. */
class SortedRows {
  private sorter: DepthSorter;
  private readonly sent = new WeakSet<Uint32Array>();
  private rowsToShow = 0;
  private forward: readonly number[] | undefined;
  private sortedFor: readonly number[] | undefined;
  private isSorting = false;
  private isStale = false;
  private isClosed = false;
  private spare: Uint32Array | undefined;

  /** @param sorted - Called with the rows from the farthest to the nearest, and their number. */
  constructor(
    private readonly rows: PackedRows,
    private readonly sorted: (order: Uint32Array, count: number) => void,
  ) {
    this.sorter = this.start();
  }

  /** Add the means of packed rows; compensation leaves them as they are. */
  add(firstRow: number, words: Uint32Array): void {
    if (this.sent.has(words)) return;
    this.sent.add(words);
    this.sorter.add(firstRow, words.slice());
    this.isStale = true;
  }

  /** Sort the first rows. */
  show(count: number): void {
    this.rowsToShow = count;
    this.sort();
  }

  /** Sort for a direction of view, if it has turned. */
  look(forward: readonly number[]): void {
    const before = this.sortedFor;
    this.forward = forward;
    if (before === undefined || before.reduce((sum, value, i) => sum + value * forward[i]!, 0) < SAME_DIRECTION) {
      this.isStale = true;
    }
    this.sort();
  }

  close(): void {
    this.isClosed = true;
    this.sorter.close();
  }

  private start(): DepthSorter {
    const capacity = this.rows.lines * TEXTURE_WIDTH;
    if (typeof Worker === "undefined" || typeof SORT_TEXT !== "string")
      return new DepthSorter(capacity, undefined, () => {});
    const workers = { address: TEXT_ADDRESS, viewer: startsText(SORT_TEXT) };
    const failed = (message: string): void => {
      console.warn(`cogsplat sorts splats without a worker: ${message}`);
      this.sorter = new DepthSorter(capacity, undefined, () => {});
      this.sorter.add(0, this.rows.words.slice());
      this.isSorting = false;
      this.isStale = true;
      this.sort();
    };
    try {
      return new DepthSorter(capacity, workers, failed);
    } catch (error) {
      console.warn(`cogsplat sorts splats without a worker: ${failureText((error as Error).message, TEXT_ADDRESS)}`);
      return new DepthSorter(capacity, undefined, () => {});
    }
  }

  private sort(): void {
    const { forward, rowsToShow, sorter } = this;
    if (this.isSorting || !this.isStale || this.isClosed || forward === undefined || rowsToShow === 0) return;
    this.isSorting = true;
    this.isStale = false;
    void sorter.sort(rowsToShow, forward, this.spare).then(({ order, rows }) => {
      if (this.isClosed || sorter !== this.sorter) return;
      this.isSorting = false;
      this.spare = order;
      this.sortedFor = forward;
      this.sorted(order, rows);
      this.sort();
    });
  }
}
