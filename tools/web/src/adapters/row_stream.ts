import type { Shifts } from "../container/compensation.js";
import type { ChunkUpdate, StreamOptions } from "../loader/stream_options.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
import type { ChunkFormat } from "../workers/decode_task.js";
import { axesMatrix } from "./axes.js";

/** Options of a stream into a renderer. */
export interface AdapterOptions extends Omit<StreamOptions, "format" | "ranges"> {
  /** Shortest time between two uploads, ms, because renderers upload whole textures; 250 by default. */
  readonly uploadInterval?: number;
  /** Called after every upload with the number of rows to draw. */
  readonly onUpload?: (rows: number) => void;
  /**
   * World position of the renderer's origin, scene units; by default that of the scene's origin. It places scenes with
   * different origins relative to each other.
   */
  readonly worldOrigin?: readonly number[];
}

/** Rows of a whole scene in a renderer. */
export interface RowTarget {
  /** Format of the chunks that `write` takes. */
  readonly format: ChunkFormat;
  /** Write the rows of a chunk, with their shifts of compensation (SPEC 8.5), if any. */
  write(update: ChunkUpdate, shifts: Shifts | undefined): void;
  /** Upload the rows written, and draw the first `rows` rows. */
  upload(rows: number): void;
}

/** A stream into a renderer. */
export interface AdapterStream {
  /** Resolves when everything has been uploaded; rejects with the error that ends the stream, including an abort. */
  readonly done: Promise<void>;
  /** Abort the requests and release the memory of the renderer. */
  dispose(): void;
}

const UPLOAD_INTERVAL = 250;
/** Longest task, ms; a frame at 60 Hz has 16. */
const LONGEST_TASK = 6;

/** Return the SH degree of a stream. */
export function wantedDegree(scene: StreamedScene, options: AdapterOptions): number {
  return Math.min(options.degree ?? scene.info.shDegree, scene.info.shDegree);
}

/**
 * Fill and upload a renderer's rows as chunks arrive.
 *
 * Rows present compensate for missing ones (SPEC 8.5), less with every chunk; refinements and coefficients replace
 * rows. No task is longer than `LONGEST_TASK`.
 */
export async function streamRows(
  scene: StreamedScene,
  target: RowTarget,
  options: AdapterOptions,
  signal: AbortSignal,
): Promise<void> {
  const compensate = options.compensate ?? true;
  const rows = new DrawnRows(scene, target, compensate);
  const pace = new Pace();
  let last = -Infinity;
  const stream = scene.stream({
    ...options,
    degree: wantedDegree(scene, options),
    compensate,
    format: target.format,
    signal,
  });
  for await (const update of stream) {
    rows.put(update);
    await pace.yieldIfDue();
    if (performance.now() - last < (options.uploadInterval ?? UPLOAD_INTERVAL)) continue;
    await rows.show(pace);
    options.onUpload?.(rows.shown);
    last = performance.now();
  }
  await rows.show(pace);
  options.onUpload?.(rows.shown);
}

/** Rows received so far, without compensation while chunks are missing, and the number uploaded. */
class DrawnRows {
  shown = 0;
  private rows = 0;
  private prefix = 0;
  /** Chunks whose rows change as more of the scene arrives. */
  private readonly chunks = new Map<number, ChunkUpdate>();
  /** Chunks received since the last upload. */
  private readonly fresh = new Set<number>();
  private shownPrefix = -1;

  constructor(
    private readonly scene: StreamedScene,
    private readonly target: RowTarget,
    private readonly compensate: boolean,
  ) {}

  put(update: ChunkUpdate): void {
    this.chunks.set(update.chunk, update);
    this.fresh.add(update.chunk);
    this.rows = Math.max(this.rows, update.firstRow + update.count);
    this.prefix = update.prefix;
  }

  /** Write and upload the changed rows, if any. */
  async show(pace: Pace): Promise<void> {
    const prefix = this.prefix;
    // Compensation differs between prefixes, for every chunk.
    const changed = this.compensate && prefix !== this.shownPrefix ? [...this.chunks.keys()] : [...this.fresh];
    if (changed.length === 0) return;
    for (const chunk of changed) {
      const shifts = this.compensate && chunk < prefix ? this.scene.compensation.shifts(prefix, chunk) : undefined;
      this.target.write(this.chunks.get(chunk)!, shifts);
      await pace.yieldIfDue();
    }
    this.fresh.clear();
    this.shownPrefix = prefix;
    this.shown = this.rows;
    // The whole scene has no compensation; later updates replace whole rows.
    if (!this.compensate || prefix === this.scene.index.totalChunkCount) this.chunks.clear();
    this.target.upload(this.rows);
  }
}

/** Limits the duration of the tasks of a stream. */
class Pace {
  private since = performance.now();

  /** Yield if the present task has lasted long enough. */
  async yieldIfDue(): Promise<void> {
    if (performance.now() - this.since < LONGEST_TASK) return;
    await new Promise((resolve) => setTimeout(resolve, 0));
    this.since = performance.now();
  }
}

/** Return an abort controller that follows a signal. */
export function followingAbort(signal: AbortSignal | undefined): AbortController {
  const abort = new AbortController();
  if (signal?.aborted) abort.abort(signal.reason);
  else signal?.addEventListener("abort", () => abort.abort(signal.reason), { once: true });
  return abort;
}

/** Return the position of the scene's origin in a world with the renderer's axes, of OpenGL by default. */
export function originPosition(
  { info }: Pick<StreamedScene, "info">,
  { worldOrigin = info.origin }: AdapterOptions,
  axes?: string,
): [number, number, number] {
  const away = info.origin.map((value, axis) => value - worldOrigin[axis]!);
  const matrix = axesMatrix(info.axes, axes);
  const at = (row: number): number => away.reduce((sum, value, i) => sum + matrix[3 * row + i]! * value, 0);
  return [at(0), at(1), at(2)];
}
