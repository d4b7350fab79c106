import { failureText } from "../workers/worker_start.js";
import { sortMemory, sortSteps, type ViewPlane } from "./depth_order.js";
import type { DepthOrder, SortRequest, SortResponse } from "./sort_messages.js";
import type { ViewerWorkers } from "./viewer_workers.js";

/** Longest slice of a sort on the main thread, ms. */
const SLICE_MILLISECONDS = 4;

/** Sorts the rows of one scene by depth, in a worker or, without workers, in slices on the caller's thread. */
export class DepthSorter {
  private readonly worker: Worker | undefined;
  private readonly local: RowSorter | undefined;
  private answer: ((order: DepthOrder) => void) | undefined;

  /**
   * @param rows - Rows of the scene.
   * @param workers - Makes the worker; undefined sorts on the caller's thread.
   * @param failed - Called if the worker cannot be started.
   */
  constructor(
    rows: number,
    workers: Pick<ViewerWorkers, "address" | "viewer"> | undefined,
    failed: (message: string) => void,
  ) {
    if (workers === undefined) {
      this.local = new RowSorter(rows);
      return;
    }
    this.worker = workers.viewer();
    this.worker.onmessage = ({ data }: MessageEvent<SortResponse>) => this.answer?.(data);
    this.worker.onerror = (event) => failed(failureText(event.message, workers.address));
    this.send({ type: "allocate", rows }, []);
  }

  /** Add means of rows; their buffer is transferred. */
  add(firstRow: number, means: Float32Array): void {
    if (this.local) this.local.add(firstRow, means);
    else this.send({ type: "rows", firstRow, means }, [means.buffer as ArrayBuffer]);
  }

  /**
   * Sort the first rows. One sort runs at a time.
   *
   * @param plane - Plane of the camera.
   * @param spare - An unused order, whose memory is reused.
   */
  async sort(rows: number, plane: ViewPlane, spare: Uint32Array | undefined): Promise<DepthOrder> {
    if (this.local) return this.local.sortInSlices(rows, plane, spare);
    return new Promise((resolve) => {
      this.answer = resolve;
      this.send({ type: "sort", rows, plane, spare }, spare ? [spare.buffer as ArrayBuffer] : []);
    });
  }

  close(): void {
    this.worker?.terminate();
  }

  private send(request: SortRequest, transfer: ArrayBuffer[]): void {
    this.worker!.postMessage(request, transfer);
  }
}

/** Means of a scene, sorted by depth. */
export class RowSorter {
  private readonly means: Float32Array;
  private readonly memory;

  constructor(private readonly rows: number) {
    this.means = new Float32Array(3 * rows);
    this.memory = sortMemory(rows);
  }

  add(firstRow: number, means: Float32Array): void {
    this.means.set(means, 3 * firstRow);
  }

  sort(rows: number, plane: ViewPlane, spare: Uint32Array | undefined): DepthOrder {
    const start = performance.now();
    const order = spare ?? new Uint32Array(this.rows);
    for (const _ of sortSteps(this.means, rows, plane, order, this.memory));
    return { order, rows, milliseconds: performance.now() - start };
  }

  /** Sort in slices, so that the page stays responsive. */
  async sortInSlices(rows: number, plane: ViewPlane, spare: Uint32Array | undefined): Promise<DepthOrder> {
    const start = performance.now();
    const order = spare ?? new Uint32Array(this.rows);
    let slice = start;
    for (const _ of sortSteps(this.means, rows, plane, order, this.memory)) {
      if (performance.now() - slice < SLICE_MILLISECONDS) continue;
      await new Promise((resolve) => setTimeout(resolve, 0));
      slice = performance.now();
    }
    return { order, rows, milliseconds: performance.now() - start };
  }
}
