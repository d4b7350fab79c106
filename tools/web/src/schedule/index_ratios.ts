import type { Index } from "../container/scene_index.js";
import type { ViewTable } from "../container/view_table.js";
import { byBoxes, byViewTable, LEAST_RATIO, type PoseRatios } from "./chunk_ratios.js";
import type { Pose } from "./poses.js";

/**
 * Ratios of the chunks and pages of all indexes read, one for each row of `SceneRows` (docs/streaming.md, 4 and 5).
 *
 * In an index, ratios are relative to all that it lists, by its view table or by boxes; below a page they are multiplied
 * by the ratio of the page.
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
    for (const index of this.indexes) {
      const { page, firstRow } = index;
      const own = this.ratiosOf(index)(pose);
      const ofPage = page && found[page.row]!;
      found.set(ofPage === undefined ? own : own.map((ratio) => Math.max(ofPage * ratio, LEAST_RATIO)), firstRow);
    }
    return found;
  };

  private ratiosOf(index: Index): PoseRatios {
    const known = this.known.get(index);
    if (known !== undefined) return known;
    const table = this.tables.get(index);
    const { boxes, contribution } = index;
    const ratios = table === undefined ? byBoxes(boxes, contribution) : byViewTable(table, boxes, contribution);
    this.known.set(index, ratios);
    return ratios;
  }
}
