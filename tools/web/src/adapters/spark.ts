import type { ChunkUpdate, StreamOptions } from "../loader/stream_options.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
import { DEFAULT_RANGES, SH_WORDS, shiftPacked } from "../scene/packed_splats.js";
import { axesRotation } from "./axes.js";

/** What the adapter uses of Spark's `PackedSplats`. */
export interface SparkPackedSplats {
  numSplats: number;
  needsUpdate: boolean;
  readonly extra: Record<string, unknown>;
  ensureSplats(count: number): Uint32Array;
  ensureSplatsSh(level: number, count: number): Uint32Array;
}

/** What the adapter uses of Spark's `SplatMesh`. */
export interface SparkMesh {
  numSplats: number;
  readonly quaternion: { set(x: number, y: number, z: number, w: number): unknown };
  updateVersion(): void;
}

/** The two classes of `@sparkjsdev/spark` that the adapter makes objects of. */
export interface SparkModule<M extends SparkMesh> {
  readonly PackedSplats: new (options: {
    maxSplats: number;
    splatEncoding: { rgbMin: number; rgbMax: number; sh1Max: number; sh2Max: number; sh3Max: number };
  }) => SparkPackedSplats;
  readonly SplatMesh: new (options: { packedSplats: SparkPackedSplats }) => M;
}

/** How a scene is streamed into Spark. */
export interface SparkOptions extends Omit<StreamOptions, "format"> {
  /** Shortest time between two uploads, ms: Spark uploads whole textures. 250 by default. */
  readonly uploadInterval?: number;
  /** Told after every upload how many splats there are. */
  readonly onUpload?: (splats: number) => void;
}

const UPLOAD_INTERVAL = 250;
/** Spark 2.2 draws with this range whatever its `splatEncoding` says, measured in Chromium. */
const SPARK_COLOURS = { rgbMin: 0, rgbMax: 1 } as const;

/**
 * Stream a scene into a mesh of Spark (three.js).
 *
 * The mesh can be added to a three.js scene at once; splats appear as chunks arrive, and get their view-dependent
 * colour and finer values in place. Rows that have not come are fully transparent; those that are there make up for
 * them (SPEC 8.5) unless `compensate` is false.
 *
 * @param spark - The module `@sparkjsdev/spark`, 2.1 or later.
 * @returns The mesh, and a promise that is kept when everything has been uploaded.
 *
 * @example
 * ```ts
 * import * as spark from "@sparkjsdev/spark";
 * const { mesh, done } = streamToSpark(await StreamedScene.open(url), spark);
 * world.add(mesh);
 * await done;
 * ```
 */
export function streamToSpark<M extends SparkMesh>(
  scene: StreamedScene, spark: SparkModule<M>, options: SparkOptions = {},
): { readonly mesh: M; readonly done: Promise<void> } {
  const degree = Math.min(options.degree ?? scene.info.shDegree, scene.info.shDegree);
  const ranges = { ...DEFAULT_RANGES, ...SPARK_COLOURS, ...options.ranges };
  const { rgbMin, rgbMax, shRange } = ranges;
  const total = scene.info.splats;
  const packed = new spark.PackedSplats({
    maxSplats: total,
    splatEncoding: { rgbMin, rgbMax, sh1Max: shRange, sh2Max: shRange, sh3Max: shRange },
  });
  const words = packed.ensureSplats(total);
  // Spark makes the textures of the bands once, so they are reserved for the whole scene before the first is drawn.
  const bands = SH_WORDS.slice(0, degree).map((_, band) => packed.ensureSplatsSh(band + 1, total));
  const mesh = new spark.SplatMesh({ packedSplats: packed });
  mesh.quaternion.set(...axesRotation(scene.info.axes));

  const compensate = options.compensate ?? true;
  /** Words as they were decoded, for chunks that make up for others. */
  const decoded = new Map<number, ChunkUpdate>();
  let rows = 0;
  let prefix = 0;
  const write = (update: ChunkUpdate): void => {
    const { packed: chunk, firstRow, count } = update;
    words.set(chunk!.words, 4 * firstRow);
    chunk!.sh.forEach((band, i) => bands[i]!.set(band, SH_WORDS[i]! * firstRow));
    if (compensate) decoded.set(update.chunk, update);
    rows = Math.max(rows, firstRow + count);
    prefix = update.prefix;
  };
  const applyShifts = (): void => {
    for (const [chunk, { packed: chunkSplats, firstRow }] of decoded) {
      const shifts = chunk < prefix ? scene.compensation.shifts(prefix, chunk) : undefined;
      const original = chunkSplats!.words;
      if (shifts === undefined) words.set(original, 4 * firstRow);
      else shiftPacked(original, shifts, words, 4 * firstRow);
    }
    // With the whole scene there, nothing is added any more.
    if (prefix === scene.index.totalChunkCount) decoded.clear();
  };
  const upload = (): void => {
    applyShifts();
    packed.numSplats = rows;
    packed.needsUpdate = true;
    bands.forEach((_, i) => refreshTexture(packed.extra[`sh${i + 1}Texture`]));
    mesh.numSplats = rows;
    mesh.updateVersion();
    options.onUpload?.(rows);
  };
  const streamed = { ...options, ranges, degree, compensate, format: "packed" } as const;
  return { mesh, done: run(scene, streamed, write, upload, options.uploadInterval) };
}

async function run(
  scene: StreamedScene, options: StreamOptions, write: (update: ChunkUpdate) => void, upload: () => void,
  interval = UPLOAD_INTERVAL,
): Promise<void> {
  let last = -Infinity;
  let changed = false;
  for await (const update of scene.stream(options)) {
    write(update);
    changed = true;
    const now = performance.now();
    if (now - last < interval) continue;
    upload();
    [last, changed] = [now, false];
  }
  if (changed) upload();
}

/** A texture of a band exists once Spark has drawn; `needsUpdate` of the splats does not refresh it. */
function refreshTexture(texture: unknown): void {
  const value = (texture as { value?: { needsUpdate: boolean } } | undefined)?.value;
  if (value !== undefined) value.needsUpdate = true;
}
