// Program of an adapter's worker: it sorts the rows of one scene.
import { RowSorter } from "./depth_sorter.js";
import type { SortRequest, SortResponse } from "./sort_messages.js";

/** The worker's side of the messages; `lib.webworker` conflicts with `lib.dom`. */
interface WorkerScope {
  onmessage: ((event: MessageEvent<SortRequest>) => void) | null;
  postMessage(message: SortResponse, transfer: ArrayBuffer[]): void;
}

const scope = globalThis as unknown as WorkerScope;
let sorter: RowSorter | undefined;

scope.onmessage = ({ data }) => {
  if (data.type === "allocate") sorter = new RowSorter(data.rows);
  else if (data.type === "rows") sorter!.add(data.firstRow, data.means);
  else {
    const sorted = sorter!.sort(data.rows, data.plane, data.spare);
    scope.postMessage(sorted, [sorted.order.buffer as ArrayBuffer]);
  }
};
