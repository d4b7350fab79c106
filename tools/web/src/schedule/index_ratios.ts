import type { Index } from "../container/scene_index.js";
import type { ViewTable } from "../container/view_table.js";
import { overUsual, type PoseRatios, visibleInBoxes, visibleInTable } from "./chunk_ratios.js";
import type { Pose } from "./poses.js";

/**
 * Ratios of the chunks and pages of all indexes read, one for each row of `SceneRows` (docs/streaming.md, 4 and 5).
 *
 * They are relative to all chunks of these indexes, and to the pages that are not read.
 */
export class IndexRatios {
  private readonly tables = new Map<Index, ViewTable>();
  private readonly known = new Map<Index, PoseRatios>();

  /** @param indexes - The root and the pages read so far, each after the index that lists it. */
  constructor(private readonly indexes: readonly Index[]) {}

  /** Use the view table of an index from now on. */
  setTable(index: Index, table: ViewTable): void {
    this.tables.set(index, table);
    this.known.delete(index);
  }

  readonly of = (pose: Pose): Float64Array => {
    const last = this.indexes.at(-1)!;
    const found = new Float64Array(last.firstRow + last.contribution.length);
    const readPages = new Set(this.indexes.map(({ page }) => page?.row));
    // In file order, in which Python adds as well.
    const indexes = [...this.indexes].sort((a, b) => a.start - b.start);
    /** Sum over the chunks, and the pages that are not read. */
    const sumOf = (valuesOf: (index: Index) => Float64Array): number =>
      indexes.reduce((sum, index) => {
        const own = valuesOf(index).reduce(
          (ofIndex, value, i) => (readPages.has(index.firstRow + i) ? ofIndex : ofIndex + value),
          0,
        );
        return sum + own;
      }, 0);
    const whole = sumOf(({ contribution }) => contribution);
    const visible = new Map(
      indexes.map((index) => {
        const own = this.visibilityOf(index)(pose);
        // Contributions, as shares like those of view tables.
        return [index, this.tables.has(index) ? own : own.map((value) => value / (whole || 1))];
      }),
    );
    const allVisible = sumOf((index) => visible.get(index)!);
    for (const [{ contribution, firstRow }, own] of visible) {
      found.set(overUsual(own, contribution, allVisible, whole), firstRow);
    }
    return found;
  };

  private visibilityOf(index: Index): PoseRatios {
    const known = this.known.get(index);
    if (known !== undefined) return known;
    const table = this.tables.get(index);
    const { boxes, contribution } = index;
    const visible =
      table === undefined ? visibleInBoxes(boxes, contribution) : visibleInTable(table, boxes, contribution);
    this.known.set(index, visible);
    return visible;
  }
}
