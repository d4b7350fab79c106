/**
 * Scenes in Babylon.js: the entry point `cogsplat/babylon`.
 *
 * @packageDocumentation
 */
import type { Shifts } from "../container/compensation.js";
import type { ChunkUpdate } from "../loader/stream_options.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
import { opacityOf, shiftedOpacity } from "../scene/opacities.js";
import { axesMatrix, axesRotation } from "./axes.js";
import {
  type AdapterOptions,
  type AdapterStream,
  followingAbort,
  type RowTarget,
  streamRows,
  wantedDegree,
} from "./row_stream.js";

export type { AdapterOptions, AdapterStream } from "./row_stream.js";

/** Part of a `Vector3` that the adapter uses. */
interface BabylonVector {
  y: number;
  set(x: number, y: number, z: number): unknown;
}

/** Part of a `Scene` that the adapter uses. */
export interface BabylonScene {
  readonly useRightHandedSystem: boolean;
  getEngine(): { getCaps(): { readonly maxTextureSize: number } };
}

/** Part of a `GaussianSplattingMesh` that the adapter uses. */
export interface BabylonMesh {
  rotationQuaternion: unknown;
  readonly scaling: BabylonVector;
  readonly position: BabylonVector;
  updateDataAsync(data: ArrayBuffer, sh?: Uint8Array[], partIndices?: Uint8Array, shDegree?: number): Promise<void>;
  dispose(): void;
}

/** Classes of `@babylonjs/core` that the adapter instantiates. */
export interface BabylonModule<S extends BabylonScene, M extends BabylonMesh> {
  readonly GaussianSplattingMesh: new (name: string, url: null, scene: S) => M;
  readonly Quaternion: new (x: number, y: number, z: number, w: number) => unknown;
}

/** A scene in Babylon.js. */
export interface BabylonSplats<M extends BabylonMesh> extends AdapterStream {
  /** Mesh in the Babylon.js scene; it fills as chunks arrive. */
  readonly mesh: M;
}

/** Shortest time between two uploads, ms: the engine packs all splats again for each. */
const UPLOAD_INTERVAL = 1000;
/** Bytes of a splat, and of its coefficients in one texture, in the engine's own layout. */
const ROW_BYTES = 32;
const TEXEL_BYTES = 16;
const SH_C0 = 0.28209479177387814;
/** Scale of rows that have not arrived, which are transparent; the engine divides by it. */
const NO_SCALE = 1e-6;

/**
 * Stream a scene into a mesh of Babylon.js.
 *
 * Splats appear as chunks arrive; refinements and SH coefficients replace their rows. Missing rows are transparent, and
 * the others compensate for them (SPEC 8.5) unless `compensate` is false. The engine sorts them by depth, holds colours
 * and rotations in bytes, and takes 36 bytes for a splat in graphics memory, and 48 for the bands of degree 3.
 *
 * @param babylon - The module `@babylonjs/core`, 9 or later, or an object with its two classes.
 * @param world - Scene of Babylon.js that gets the mesh.
 *
 * @example
 * ```ts
 * import { GaussianSplattingMesh, Quaternion } from "@babylonjs/core";
 * import { DecoderPool, StreamedScene } from "cogsplat";
 * import { streamToBabylon } from "cogsplat/babylon";
 *
 * const scene = await StreamedScene.open(url, { service: (index) => new DecoderPool(index) });
 * const { mesh, done } = streamToBabylon(scene, { GaussianSplattingMesh, Quaternion }, world);
 * await done;
 * ```
 */
export function streamToBabylon<S extends BabylonScene, M extends BabylonMesh>(
  scene: StreamedScene,
  babylon: BabylonModule<S, M>,
  world: S,
  options: AdapterOptions = {},
): BabylonSplats<M> {
  const { info } = scene;
  const rows = new BabylonRows(info.splats, wantedDegree(scene, options), world.getEngine().getCaps().maxTextureSize);
  const mesh = new babylon.GaussianSplattingMesh("cogsplat", null, world);
  place(mesh, babylon, scene, world.useRightHandedSystem ? "RUB" : "RUF", options.worldOrigin ?? info.origin);
  const abort = followingAbort(options.signal);
  let wanted = 0;
  let updating: Promise<void> | undefined;
  /** Give the engine all rows; what arrives meanwhile follows. */
  const update = async (): Promise<void> => {
    while (wanted > 0 && !abort.signal.aborted) {
      const data = rows.bytes.slice(0, ROW_BYTES * wanted);
      wanted = 0;
      if (rows.degree === 0) await mesh.updateDataAsync(data);
      else await mesh.updateDataAsync(data, [...rows.sh], undefined, rows.degree);
    }
    updating = undefined;
  };
  const target: RowTarget = {
    format: "splats",
    write: (chunk, shifts) => rows.write(chunk, shifts),
    upload(count: number): void {
      wanted = count;
      updating ??= update();
    },
  };
  const done = streamRows(scene, target, { uploadInterval: UPLOAD_INTERVAL, ...options }, abort.signal).then(
    async () => {
      await updating;
    },
  );
  return {
    mesh,
    done,
    dispose(): void {
      abort.abort();
      mesh.dispose();
    },
  };
}

/** Rows in the layout of `.splat` files, and coefficients above DC in bytes. */
class BabylonRows {
  readonly bytes: ArrayBuffer;
  /** Bytes of the textures of coefficients, 16 for each splat. */
  readonly sh: readonly Uint8Array[];
  private readonly floats: Float32Array;
  private readonly codes: Uint8Array;

  /** @param width - Width of the engine's textures, of which each has a line more than it needs. */
  constructor(
    splats: number,
    readonly degree: number,
    width: number,
  ) {
    this.bytes = new ArrayBuffer(ROW_BYTES * splats);
    this.floats = new Float32Array(this.bytes);
    this.codes = new Uint8Array(this.bytes);
    for (let row = 0; row < splats; row++) this.floats.fill(NO_SCALE, 8 * row + 3, 8 * row + 6);
    const texels = width * (Math.ceil(splats / width) + 1);
    const textures = Math.ceil(coefficientsOf(degree) / TEXEL_BYTES);
    this.sh = Array.from({ length: textures }, () => new Uint8Array(TEXEL_BYTES * texels).fill(128));
  }

  write({ firstRow, splats }: ChunkUpdate, shifts: Shifts | undefined): void {
    const { count, means, scales, quats, opacities, sh0, shN, shDegree } = splats!;
    const { floats, codes } = this;
    for (let i = 0; i < count; i++) {
      const row = firstRow + i;
      for (let axis = 0; axis < 3; axis++) {
        floats[8 * row + axis] = means[3 * i + axis]!;
        floats[8 * row + 3 + axis] = Math.exp(scales[3 * i + axis]! + (shifts?.scales[i] ?? 0));
        codes[32 * row + 24 + axis] = byte(255 * (0.5 + SH_C0 * sh0[3 * i + axis]!));
      }
      const opacity = opacityOf(opacities[i]!);
      codes[32 * row + 27] = byte(255 * (shifts ? shiftedOpacity(opacity, shifts.opacities[i]!) : opacity));
      for (let k = 0; k < 4; k++) codes[32 * row + 28 + k] = byte(127.5 + 127.5 * quats[4 * i + k]!);
      const stored = coefficientsOf(shDegree);
      for (let k = 0; k < coefficientsOf(this.degree); k++) {
        const code = k < stored ? byte(127.5 + 127.5 * shN[stored * i + k]!) : 128;
        this.sh[Math.floor(k / TEXEL_BYTES)]![TEXEL_BYTES * row + (k % TEXEL_BYTES)] = code;
      }
    }
  }
}

/** Return the number of values above DC of a splat. */
function coefficientsOf(degree: number): number {
  return 3 * ((degree + 1) ** 2 - 1);
}

function byte(value: number): number {
  return Math.min(Math.max(Math.round(value), 0), 255);
}

/** Turn and place a mesh from the scene's axes to those of the world, which may be a reflection. */
function place<M extends BabylonMesh>(
  mesh: M,
  { Quaternion }: Pick<BabylonModule<never, M>, "Quaternion">,
  { info }: StreamedScene,
  axes: string,
  origin: readonly number[],
): void {
  const opposite: Readonly<Record<string, string>> = { R: "L", L: "R", U: "D", D: "U", F: "B", B: "F" };
  const [x, y, z] = info.axes as unknown as [string, string, string];
  try {
    mesh.rotationQuaternion = new Quaternion(...axesRotation(info.axes, axes));
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    mesh.rotationQuaternion = new Quaternion(...axesRotation(`${x}${opposite[y]}${z}`, axes));
    mesh.scaling.y = -1;
  }
  const matrix = axesMatrix(info.axes, axes);
  const away = info.origin.map((value, axis) => value - origin[axis]!);
  const at = (row: number): number => away.reduce((sum, value, i) => sum + matrix[3 * row + i]! * value, 0);
  mesh.position.set(at(0), at(1), at(2));
}
