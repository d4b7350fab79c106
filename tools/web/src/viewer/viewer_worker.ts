// Program of a viewer's worker: it sorts the rows of one scene, or reads one PLY.
import { RowSorter } from "./depth_sorter.js";
import { Meter } from "./meter.js";
import type { PlyRequest, PlyResponse, RateRequest } from "./ply_messages.js";
import { readPly } from "./ply_reader.js";
import type { SortRequest, SortResponse } from "./sort_messages.js";

/** The worker's side of the messages; `lib.webworker` conflicts with `lib.dom`. */
interface WorkerScope {
  onmessage: ((event: MessageEvent<SortRequest | PlyRequest | RateRequest>) => void) | null;
  postMessage(message: SortResponse | PlyResponse, transfer: ArrayBuffer[]): void;
}

const scope = globalThis as unknown as WorkerScope;
let sorter: RowSorter | undefined;
const meter = new Meter();

scope.onmessage = ({ data }) => {
  if (data.type === "allocate") sorter = new RowSorter(data.rows);
  else if (data.type === "rows") sorter!.add(data.firstRow, data.means);
  else if (data.type === "sort") {
    const sorted = sorter!.sort(data.rows, data.plane, data.spare);
    scope.postMessage(sorted, [sorted.order.buffer as ArrayBuffer]);
  } else {
    meter.bitsPerSecond = data.bitsPerSecond;
    if (data.type === "ply") void readPly(data, meter, (response, transfer) => scope.postMessage(response, transfer));
  }
};
