import { parentsOf } from "../container/chunk_sets.js";
import type { SceneIndex } from "../container/scene_index.js";
import { SegmentKind } from "../container/tables.js";
import type { ViewTable } from "../container/view_table.js";
import { along, byBoxes, byViewTable, type PoseRatios } from "../schedule/chunk_ratios.js";
import { path, type Pose } from "../schedule/poses.js";
import { Scheduler, type Unit } from "../schedule/scheduler.js";
import type { SegmentOrder } from "./stream_options.js";

export { along, byBoxes, bySgss, byViewTable, type PoseRatios } from "../schedule/chunk_ratios.js";
export { path, predicted, type Pose, type WeightedPose } from "../schedule/poses.js";
export { Scheduler, type Decision, type Holdings, type Unit } from "../schedule/scheduler.js";

/** What is taken from an index. */
type Index = Pick<SceneIndex, "segments" | "chunks" | "complete" | "range" | "codebookSegmentsOf">;

/** Kinds of segments that are chosen by what a visitor sees. */
const CHOSEN: readonly number[] = [
  SegmentKind.head, SegmentKind.refinement, SegmentKind.tail,
  SegmentKind.shapeCodebook, SegmentKind.colourBand1, SegmentKind.colourBand2, SegmentKind.colourBand3,
];
const OF_CHUNKS: readonly number[] = CHOSEN.slice(0, 3);
const MAX_DEGREE = 3;

/**
 * The option `order` of a stream for a visitor: what the pose and the next second of the path show comes first.
 *
 * @param pose - Where the visitor is; asked before every request.
 *
 * @example
 * ```ts
 * for await (const update of scene.stream({ order: byView(() => camera.pose) })) draw(update);
 * ```
 */
export function byView(pose: () => Pose): (index: SceneIndex) => SegmentOrder {
  return (index) => new ViewOrder(index, pose);
}

/** Orders segments by what a visitor sees (docs/streaming.md): by the view table once it is there, by boxes until then. */
export class ViewOrder implements SegmentOrder {
  private table: ViewTable | undefined;
  private ratios: PoseRatios | undefined;
  /** Chunks that `ratios` knows. */
  private known = 0;
  private last: { readonly pose: Pose; readonly seconds: number } | undefined;

  constructor(
    private readonly index: Index,
    private readonly pose: () => Pose,
  ) {}

  useTable(table: ViewTable): void {
    this.table = table;
    this.ratios = undefined;
  }

  order(segments: readonly number[], seconds: number): number[] {
    const { kind } = this.index.segments;
    const now = this.pose();
    const before = this.last ?? { pose: now, seconds };
    this.last = { pose: now, seconds };
    const rows = Array.from(kind.keys()).filter((segment) => CHOSEN.includes(kind[segment]!));
    const wanted = new Set(segments);
    const there = new Set(rows.flatMap((segment, unit) => (wanted.has(segment) ? [] : [unit])));
    const ratios = along(this.currentRatios(), path(now, before.pose, seconds - before.seconds));
    // Everything is put in order at once: requests are cut from the front of it.
    const everything = { underWay: new Set<number>(), received: new Map<number, number>(), budgetSplats: 0, bytesPerSecond: Infinity, latency: 0 };
    const { fetch } = new Scheduler(this.units(rows), this.index.chunks.splats).decide(ratios, { there, ...everything });
    // What is no part of the choice is small, the view table among it.
    const others = segments.filter((segment) => !CHOSEN.includes(kind[segment]!)).sort((a, b) => a - b);
    return [...others, ...fetch.map((unit) => rows[unit]!)];
  }

  private units(rows: readonly number[]): Unit[] {
    const { kind, owner } = this.index.segments;
    const unitOf = new Map(rows.map((segment, unit) => [segment, unit]));
    const heads = new Map(rows.flatMap((segment, unit) => (kind[segment] === SegmentKind.head ? [[owner[segment]!, unit]] : [])));
    const parents = parentsOf(this.index.chunks.cell);
    return rows.map((segment) => {
      const { offset, length } = this.index.range(segment);
      const isHead = kind[segment] === SegmentKind.head;
      const chunk = OF_CHUNKS.includes(kind[segment]!) ? owner[segment]! : -1;
      const books = chunk < 0 ? [] : (this.index.codebookSegmentsOf(segment, MAX_DEGREE) ?? []);
      const before = chunk < 0 ? undefined : heads.get(isHead ? parents[chunk]! : chunk);
      const after = [...books.map((book) => unitOf.get(book)), before].filter((unit) => unit !== undefined);
      return { chunk, isHead, end: offset + length, size: length, after };
    });
  }

  private currentRatios(): PoseRatios {
    const { box, contribution } = this.index.chunks;
    if (this.ratios !== undefined && this.known === contribution.length) return this.ratios;
    this.known = contribution.length;
    // The table is about all chunks of the file: while boxes are missing it cannot be used.
    const table = this.index.complete ? this.table : undefined;
    this.ratios = table === undefined ? byBoxes(box, contribution) : byViewTable(table, box, contribution);
    return this.ratios;
  }
}
