import { isClosed, type SetState, setStates } from "../container/chunk_sets.js";
import type { Shifts } from "../container/compensation.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
import type { VisitChange } from "../loader/visit.js";
import { type PackedSplats, SH_WORDS } from "../scene/packed_splats.js";
import { effectiveSplats } from "../schedule/chunk_ratios.js";
import { type Child, childrenOf, growth } from "../schedule/growth.js";
import { type RowRun, RowSlots } from "./row_slots.js";
import type { SplatLayer } from "./splat_layer.js";

/** Time for which the camera rests before chunks are changed for its view, ms (docs/streaming.md, 10). */
const STILL_MILLISECONDS = 250;

/**
 * What a chunk is compensated for: a state of the layers, or, after the chunks of the last layer, its children; neither if
 * nothing is to be changed.
 */
interface Compensated {
  readonly chunk: number;
  readonly state?: SetState | undefined;
  readonly children?: readonly Child[] | undefined;
}

/** Fills a layer with the chunks of a visit, and removes evicted ones. */
export class VisitedScene {
  /** Splats in memory. */
  splats = 0;
  /** Rows of the chunks in memory. */
  private readonly rows = new Map<number, readonly RowRun[]>();
  /** Allocator of rows; undefined where the layer has room for the scene, so that each chunk has its own rows. */
  private readonly slots: RowSlots | undefined;
  /** What each chunk is compensated for, and chunks of the last layer known then, as text. */
  private readonly compensatedFor = new Map<number, string>();
  private waiting: Compensated[] = [];
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
    // A refinement moves means.
    this.compensatedFor.delete(chunk);
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
      this.compensate(this.waiting.pop()!);
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
    const { layerChunks } = compensation;
    const isSet = rows.isCut && isClosed(held, rows);
    const states = isSet ? setStates(held, rows, layerChunks, counts) : [];
    const children = isSet ? childrenOf(held, rows, counts) : new Map<number, readonly Child[]>();
    this.waiting = [];
    for (const [i, chunk] of held.entries()) {
      // A set that is neither cut nor a prefix is not compensated.
      const state = states[i] ?? { prefix: isPrefix ? held.length : index.totalChunkCount, share: undefined };
      const wanted = isSet && chunk >= layerChunks ? { chunk, children: children.get(chunk) } : { chunk, state };
      if (this.compensatedFor.get(chunk) !== this.textOf(wanted)) this.waiting.push(wanted);
    }
  }

  private textOf({ state, children }: Compensated): string {
    const missing = children?.map((child) => `${child.row}:${child.missing}`);
    return `${state?.prefix} ${state?.share} ${missing} ${this.scene.compensation.layerChunks}`;
  }

  private shiftsFor({ chunk, state, children }: Compensated): Shifts | undefined {
    if (state !== undefined) return this.scene.compensation.shifts(state.prefix, chunk, state.share);
    if (children === undefined) return undefined;
    const scales = growth(this.meansOf(chunk), children);
    return { scales, opacities: new Float32Array(scales.length) };
  }

  private meansOf(chunk: number): Float32Array {
    const runs = this.rows.get(chunk)!;
    const means = new Float32Array(3 * runs.reduce((sum, { count }) => sum + count, 0));
    let from = 0;
    for (const { first, count } of runs) {
      this.layer.readMeans(first, means.subarray(3 * from, 3 * (from + count)));
      from += count;
    }
    return means;
  }

  private compensate(wanted: Compensated): void {
    const { chunk } = wanted;
    this.compensatedFor.set(chunk, this.textOf(wanted));
    const shifts = this.shiftsFor(wanted);
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
