import type { ViewPlane } from "../viewer/depth_order.js";
import { DepthSorter } from "../viewer/depth_sorter.js";
import { failureText, startsText, TEXT_ADDRESS } from "../workers/worker_start.js";

/** Program of the sorting worker, which the bundle defines (`scripts/bundle.mjs`). */
declare const SORT_TEXT: string | undefined;

/** Cosine of the angle by which a view may turn before rows are sorted again: 0.05 degrees. */
const SAME_DIRECTION = 1 - 4e-7;

/** Rows sorted by depth in a worker, or on this thread where it cannot be started. */
export class SortedRows {
  private sorter: DepthSorter;
  private readonly sent = new WeakSet<Float32Array>();
  private rowsToShow = 0;
  private plane: ViewPlane | undefined;
  private sortedFor: readonly number[] | undefined;
  private isSorting = false;
  private isStale = false;
  private isClosed = false;
  private spare: Uint32Array | undefined;

  /**
   * @param means - Returns the means of all rows, three each, for a sorter that takes over.
   * @param capacity - Number of rows.
   * @param sorted - Called with the rows from the farthest to the nearest, and their number.
   */
  constructor(
    private readonly means: () => Float32Array,
    private readonly capacity: number,
    private readonly sorted: (order: Uint32Array, count: number) => void,
  ) {
    this.sorter = this.start();
  }

  /** Add the means of rows; compensation leaves them as they are. */
  add(firstRow: number, means: Float32Array): void {
    if (this.sent.has(means)) return;
    this.sent.add(means);
    this.sorter.add(firstRow, means.slice());
    this.isStale = true;
  }

  /** Sort the first rows. */
  show(count: number): void {
    this.rowsToShow = count;
    this.sort();
  }

  /** Sort for a view, if its direction has turned. */
  look(plane: ViewPlane): void {
    const before = this.sortedFor;
    this.plane = plane;
    if (before === undefined || before.reduce((sum, value, i) => sum + value * plane.forward[i]!, 0) < SAME_DIRECTION) {
      this.isStale = true;
    }
    this.sort();
  }

  close(): void {
    this.isClosed = true;
    this.sorter.close();
  }

  private start(): DepthSorter {
    const { capacity } = this;
    if (typeof Worker === "undefined" || typeof SORT_TEXT !== "string")
      return new DepthSorter(capacity, undefined, () => {});
    const workers = { address: TEXT_ADDRESS, viewer: startsText(SORT_TEXT) };
    const failed = (message: string): void => {
      console.warn(`cogsplat sorts splats without a worker: ${message}`);
      this.sorter = new DepthSorter(capacity, undefined, () => {});
      this.sorter.add(0, this.means());
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
    const { plane, rowsToShow, sorter } = this;
    if (this.isSorting || !this.isStale || this.isClosed || plane === undefined || rowsToShow === 0) return;
    this.isSorting = true;
    this.isStale = false;
    void sorter.sort(rowsToShow, plane, this.spare).then(({ order, rows }) => {
      if (this.isClosed || sorter !== this.sorter) return;
      this.isSorting = false;
      this.spare = order;
      this.sortedFor = plane.forward;
      this.sorted(order, rows);
      this.sort();
    });
  }
}
