import type { ViewPlane } from "./depth_order.js";
import type { DepthSorter } from "./depth_sorter.js";
import type { DepthOrder } from "./sort_messages.js";

/** Cosine of the angle by which a view may turn before rows are sorted again: 0.05 degrees. */
const SAME_DIRECTION = 1 - 4e-7;

/** Order of rows by depth, renewed when rows arrive or the view turns; one sort runs at a time. */
export class RowOrder {
  private rows = 0;
  /** Plane of the last view. */
  private plane: ViewPlane | undefined;
  private sortedFor: readonly number[] | undefined;
  private isRunning = false;
  private isStale = false;
  private isClosed = false;
  private spare: Uint32Array | undefined;

  /**
   * @param sorter - Sorter of the rows.
   * @param sorted - Called with each new order; returns an unused order, whose memory is reused.
   */
  constructor(
    private sorter: DepthSorter,
    private readonly sorted: (order: DepthOrder) => Uint32Array | undefined,
  ) {}

  /** Whether a sort is running. */
  get isSorting(): boolean {
    return this.isRunning;
  }

  /** Add means of rows, whose buffer is transferred; they are sorted with the next `show` or `look`. */
  add(firstRow: number, means: Float32Array): void {
    this.sorter.add(firstRow, means);
    this.isStale = true;
  }

  /** Sort the first rows from now on; before the first view nothing is sorted. */
  show(rows: number): void {
    if (rows !== this.rows) this.isStale = true;
    this.rows = rows;
    this.sort();
  }

  /**
   * Sort for a view, if its direction has turned or rows were added.
   *
   * @param plane - Plane of the camera, in the space of the means.
   * @returns Whether the last order is that of the view, with all rows.
   */
  look(plane: ViewPlane): boolean {
    this.plane = plane;
    const before = this.sortedFor;
    if (before === undefined || before.reduce((sum, value, i) => sum + value * plane.forward[i]!, 0) < SAME_DIRECTION) {
      this.isStale = true;
    }
    this.sort();
    return !this.isRunning && (this.rows === 0 || !this.isStale);
  }

  /** Continue with another sorter, which holds the means of all rows. */
  continueWith(sorter: DepthSorter): void {
    this.sorter = sorter;
    this.isRunning = false;
    this.isStale = true;
    this.sort();
  }

  close(): void {
    this.isClosed = true;
    this.sorter.close();
  }

  private sort(): void {
    const { plane, rows, sorter } = this;
    if (this.isRunning || !this.isStale || this.isClosed || plane === undefined || rows === 0) return;
    this.isRunning = true;
    this.isStale = false;
    void sorter.sort(rows, plane, this.spare).then((order) => {
      if (this.isClosed || sorter !== this.sorter) return;
      this.isRunning = false;
      this.sortedFor = plane.forward;
      this.spare = this.sorted(order);
      this.sort();
    });
  }
}
