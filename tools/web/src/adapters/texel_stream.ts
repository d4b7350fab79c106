import type { StreamOptions } from "../loader/stream_options.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
import type { TexelArray, TexelLayout, Texels } from "../scene/texel_layouts.js";
import { makeTexelArrays, writeTexels } from "../scene/texels.js";
import { axesMatrix } from "./axes.js";

/** How a scene is streamed into a renderer. */
export interface AdapterOptions extends Omit<StreamOptions, "format" | "ranges"> {
  /** Shortest time between two uploads, ms, because renderers upload whole textures. 250 by default. */
  readonly uploadInterval?: number;
  /** Told after every upload how many rows may be drawn. */
  readonly onUpload?: (rows: number) => void;
  /**
   * Position in the world that the renderer's own origin stands for, scene units; the scene's origin by default. Scenes
   * with other origins are then placed where they belong beside each other.
   */
  readonly worldOrigin?: readonly number[];
}

/** The arrays of a whole scene, and what uploads them. */
export interface TexelTarget {
  /** As `texelWidths` orders them, for all of the scene's splats. */
  readonly arrays: readonly TexelArray[];
  /** Show what the arrays hold, up to a number of rows. */
  upload(rows: number): void;
}

/** A stream into a renderer. */
export interface AdapterStream {
  /** Kept when everything has been uploaded; broken by what ends the stream, an abort among it. */
  readonly done: Promise<void>;
  /** End the requests and give back what the renderer holds. */
  dispose(): void;
}

const UPLOAD_INTERVAL = 250;
/** Longest time that is worked at once, ms: a frame at 60 Hz has 16, and others work in it too. */
const LONGEST_TASK = 6;

/** SH degree that a stream asks for. */
export function wantedDegree(scene: StreamedScene, options: AdapterOptions): number {
  return Math.min(options.degree ?? scene.info.shDegree, scene.info.shDegree);
}

/**
 * Fill a renderer's arrays as chunks come, and have them uploaded at intervals.
 *
 * Rows that are there make up for those that are not (SPEC 8.5), less with every chunk; refinements and coefficients
 * take the places of the rows that they replace. No more is done at once than fits into a frame.
 */
export async function streamTexels(
  scene: StreamedScene,
  layout: TexelLayout,
  target: TexelTarget,
  options: AdapterOptions,
  signal: AbortSignal,
): Promise<void> {
  const compensate = options.compensate ?? true;
  const rows = new DrawnRows(scene, target, compensate);
  const pace = new Pace();
  let last = -Infinity;
  const stream = scene.stream({ ...options, degree: wantedDegree(scene, options), compensate, format: layout, signal });
  for await (const update of stream) {
    rows.put(update.chunk, { texels: update.texels!, firstRow: update.firstRow }, update.prefix);
    await pace.rest();
    if (performance.now() - last < (options.uploadInterval ?? UPLOAD_INTERVAL)) continue;
    await rows.show(pace);
    options.onUpload?.(rows.shown);
    last = performance.now();
  }
  await rows.show(pace);
  options.onUpload?.(rows.shown);
}

/** Arrays for a scene, of a degree. */
export function sceneArrays(scene: StreamedScene, layout: TexelLayout, degree: number): TexelArray[] {
  return makeTexelArrays(layout, degree, scene.info.splats);
}

interface ChunkRows {
  readonly texels: Texels;
  readonly firstRow: number;
}

/** The rows that have come, as they were decoded while others are missing, and how much of them is uploaded. */
class DrawnRows {
  shown = 0;
  private rows = 0;
  private prefix = 0;
  /** Chunks whose rows change while more of the scene comes. */
  private readonly chunks = new Map<number, ChunkRows>();
  /** Chunks that have come since the last upload. */
  private readonly fresh = new Set<number>();
  private shownPrefix = -1;

  constructor(
    private readonly scene: StreamedScene,
    private readonly target: TexelTarget,
    private readonly compensate: boolean,
  ) {}

  put(chunk: number, rows: ChunkRows, prefix: number): void {
    this.chunks.set(chunk, rows);
    this.fresh.add(chunk);
    this.rows = Math.max(this.rows, rows.firstRow + rows.texels.count);
    this.prefix = prefix;
  }

  /** Write what has changed and upload it, if anything has. */
  async show(pace: Pace): Promise<void> {
    const prefix = this.prefix;
    // Compensation differs with the prefix, for every chunk of it.
    const changed = this.compensate && prefix !== this.shownPrefix ? [...this.chunks.keys()] : [...this.fresh];
    if (changed.length === 0) return;
    for (const chunk of changed) {
      const { texels, firstRow } = this.chunks.get(chunk)!;
      const shifts = this.compensate && chunk < prefix ? this.scene.compensation.shifts(prefix, chunk) : undefined;
      writeTexels(texels, shifts, this.target.arrays, firstRow);
      await pace.rest();
    }
    this.fresh.clear();
    this.shownPrefix = prefix;
    this.shown = this.rows;
    // With all chunks there nothing is added any more, and what comes still replaces whole rows.
    if (!this.compensate || prefix === this.scene.index.totalChunkCount) this.chunks.clear();
    this.target.upload(this.rows);
  }
}

/** Lets other work of the page have its turn. */
class Pace {
  private since = performance.now();

  /** Wait for the next turn where this one has lasted long enough. */
  async rest(): Promise<void> {
    if (performance.now() - this.since < LONGEST_TASK) return;
    await new Promise((resolve) => setTimeout(resolve, 0));
    this.since = performance.now();
  }
}

/** An abort of one's own that follows the caller's. */
export function ownAbort(signal: AbortSignal | undefined): AbortController {
  const abort = new AbortController();
  if (signal?.aborted) abort.abort(signal.reason);
  else signal?.addEventListener("abort", () => abort.abort(signal.reason), { once: true });
  return abort;
}

/** Where the scene's origin is in a world whose axes are the renderer's. */
export function placeOf(scene: StreamedScene, { worldOrigin }: AdapterOptions): [number, number, number] {
  const away = scene.info.origin.map((value, axis) => value - (worldOrigin ?? scene.info.origin)[axis]!);
  const matrix = axesMatrix(scene.info.axes);
  return [0, 1, 2].map((row) => away.reduce((sum, value, i) => sum + matrix[3 * row + i]! * value, 0)) as [
    number,
    number,
    number,
  ];
}
