import type { ViewPlane } from "../viewer/depth_order.js";
import { DepthSorter } from "../viewer/depth_sorter.js";
import { RowOrder } from "../viewer/row_order.js";
import { failureText, startsText, TEXT_ADDRESS } from "../workers/worker_start.js";

/** Program of the sorting worker, which the bundle defines (`scripts/bundle.mjs`). */
declare const SORT_TEXT: string | undefined;

/** Rows sorted by depth in a worker, or on this thread where it cannot be started. */
export class SortedRows {
  private readonly order: RowOrder;
  private readonly sent = new WeakSet<Float32Array>();

  /**
   * @param means - Returns the means of all rows, three each, for a sorter that takes over.
   * @param capacity - Number of rows.
   * @param sorted - Called with the rows from the farthest to the nearest, and their number.
   */
  constructor(
    private readonly means: () => Float32Array,
    private readonly capacity: number,
    sorted: (order: Uint32Array, count: number) => void,
  ) {
    this.order = new RowOrder(this.start(), ({ order, rows }) => {
      sorted(order, rows);
      return order;
    });
  }

  /** Add the means of rows; compensation leaves them as they are. */
  add(firstRow: number, means: Float32Array): void {
    if (this.sent.has(means)) return;
    this.sent.add(means);
    this.order.add(firstRow, means.slice());
  }

  /** Sort the first rows. */
  show(count: number): void {
    this.order.show(count);
  }

  /** Sort for a view, if its direction has turned. */
  look(plane: ViewPlane): void {
    this.order.look(plane);
  }

  close(): void {
    this.order.close();
  }

  private start(): DepthSorter {
    const { capacity } = this;
    if (typeof Worker === "undefined" || typeof SORT_TEXT !== "string")
      return new DepthSorter(capacity, undefined, () => {});
    const workers = { address: TEXT_ADDRESS, viewer: startsText(SORT_TEXT) };
    const failed = (message: string): void => {
      console.warn(`cogsplat sorts splats without a worker: ${message}`);
      const sorter = new DepthSorter(capacity, undefined, () => {});
      sorter.add(0, this.means());
      this.order.continueWith(sorter);
    };
    try {
      return new DepthSorter(capacity, workers, failed);
    } catch (error) {
      console.warn(`cogsplat sorts splats without a worker: ${failureText((error as Error).message, TEXT_ADDRESS)}`);
      return new DepthSorter(capacity, undefined, () => {});
    }
  }
}
