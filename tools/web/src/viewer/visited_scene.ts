import { isClosed, type SetState, setStates } from "../container/chunk_sets.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
import type { VisitChange } from "../loader/visit.js";
import { type PackedSplats, SH_WORDS } from "../scene/packed_splats.js";
import { effectiveSplats } from "../schedule/chunk_ratios.js";
import { type RowRun, RowSlots } from "./row_slots.js";
import type { SplatLayer } from "./splat_layer.js";

/** Time for which the camera rests before chunks are changed for its view, ms (docs/streaming.md, 10). */
const STILL_MILLISECONDS = 250;

/** Fills a layer with the chunks of a visit, and removes evicted ones. */
export class VisitedScene {
  /** Splats in memory. */
  splats = 0;
  /** Rows of the chunks in memory. */
  private readonly rows = new Map<number, readonly RowRun[]>();
  /** Allocator of rows; undefined where the layer has room for the scene, so that each chunk has its own rows. */
  private readonly slots: RowSlots | undefined;
  /** State of each chunk's compensation, and chunks of the last layer known then, as text. */
  private readonly compensatedFor = new Map<number, string>();
  private waiting: { readonly chunk: number; readonly state: SetState }[] = [];
  private isStale = false;
  /** Time of the last change of the pose, from `performance.now`, until chunks were changed for it. */
  private movedAt: number | undefined;

  /**
   * @param layer - Layer, perhaps with fewer rows than the scene.
   * @param shifted - Chunks drawn with compensation.
   * @param ratios - Returns the ratios of the latest pose (`Visit.ratios`).
   */
  constructor(
    private readonly scene: StreamedScene,
    private readonly layer: SplatLayer,
    private readonly shifted: Set<number>,
    private readonly ratios: () => Float64Array | undefined,
  ) {
    if (layer.capacity < scene.info.splats) this.slots = new RowSlots(layer.capacity);
  }

  /** Draw the rows of a change, or hide an evicted chunk. */
  apply(change: VisitChange): void {
    this.isStale = true;
    const { chunk } = change;
    if (change.kind === "evicted") {
      const runs = this.rows.get(chunk)!;
      for (const { first, count } of runs) {
        this.splats -= count;
        this.layer.clear(first, count);
        if (this.shifted.has(chunk)) this.layer.shift(first, count, undefined);
      }
      this.slots?.release(runs);
      this.rows.delete(chunk);
      this.shifted.delete(chunk);
      this.compensatedFor.delete(chunk);
      return;
    }
    const { firstRow, count, packed } = change;
    const isNew = !this.rows.has(chunk);
    const runs = this.rows.get(chunk) ?? this.slots?.allocate(count) ?? [{ first: firstRow, count }];
    this.rows.set(chunk, runs);
    if (isNew) this.splats += count;
    if (runs.length === 1) {
      this.layer.write(packed!, runs[0]!.first);
      return;
    }
    let from = 0;
    for (const run of runs) {
      this.layer.write(copyRows(packed!, from, run.count), run.first);
      from += run.count;
    }
  }

  /** Record a change of the pose. */
  poseChanged(): void {
    this.movedAt = performance.now();
  }

  /**
   * Update the compensation of chunks for their cells (SPEC 8.5) and the pose (docs/streaming.md, 10).
   *
   * @param end - Time at which to stop, from `performance.now`.
   * @returns Whether more is left to do.
   */
  work(end: number): boolean {
    if (this.movedAt !== undefined && performance.now() - this.movedAt >= STILL_MILLISECONDS) this.isStale = true;
    if (this.isStale) this.plan();
    while (this.waiting.length > 0) {
      if (performance.now() > end) return true;
      const { chunk, state } = this.waiting.pop()!;
      this.compensate(chunk, state);
    }
    return this.movedAt !== undefined;
  }

  private plan(): void {
    this.isStale = false;
    this.movedAt = undefined;
    const { index, compensation } = this.scene;
    const { rows } = index;
    const held = [...this.rows.keys()].sort((a, b) => a - b);
    const isPrefix = held.every((chunk, i) => chunk === i);
    const ratios = this.ratios();
    const counts = ratios === undefined ? rows.splats : effectiveSplats(rows.splats, ratios);
    const states =
      rows.isCut && isClosed(held, rows)
        ? setStates(held, rows, compensation.layerChunks, counts)
        : // A set that is neither is not compensated.
          held.map(() => ({ prefix: isPrefix ? held.length : index.totalChunkCount, share: undefined }));
    this.waiting = [];
    for (const [i, chunk] of held.entries()) {
      const state = states[i]!;
      if (this.compensatedFor.get(chunk) !== this.textOf(state)) this.waiting.push({ chunk, state });
    }
  }

  private textOf({ prefix, share }: SetState): string {
    return `${prefix} ${share} ${this.scene.compensation.layerChunks}`;
  }

  private compensate(chunk: number, state: SetState): void {
    const { compensation } = this.scene;
    this.compensatedFor.set(chunk, this.textOf(state));
    const shifts = compensation.shifts(state.prefix, chunk, state.share);
    if (shifts === undefined && !this.shifted.has(chunk)) return;
    let from = 0;
    for (const { first, count } of this.rows.get(chunk)!) {
      const ofRun = (values: Float32Array): Float32Array => values.subarray(from, from + count);
      this.layer.shift(first, count, shifts && { scales: ofRun(shifts.scales), opacities: ofRun(shifts.opacities) });
      from += count;
    }
    if (shifts === undefined) this.shifted.delete(chunk);
    else this.shifted.add(chunk);
    this.layer.compensated = this.shifted.size > 0;
  }
}

/** Return some rows of a chunk, with a copy of their means, which a layer transfers to the sorter. */
function copyRows(packed: PackedSplats, from: number, count: number): PackedSplats {
  const rows = <T extends Uint32Array | Float32Array>(values: T, each: number): T =>
    values.subarray(each * from, each * (from + count)) as T;
  return {
    ...packed,
    count,
    words: rows(packed.words, 4),
    means: rows(packed.means, 3).slice(),
    sh: packed.sh.map((band, i) => rows(band, SH_WORDS[i]!)),
  };
}
