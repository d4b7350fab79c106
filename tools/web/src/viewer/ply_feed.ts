import { SourceError } from "../errors.js";
import { DEFAULT_RANGES } from "../scene/packed_splats.js";
import type { PlyRequest, PlyResponse } from "./ply_messages.js";
import { readPly } from "./ply_reader.js";
import type { FeedHost, Prefix, SceneFeed } from "./scene_feed.js";
import type { SplatLayer } from "./splat_layer.js";
import type { ViewerWorkers } from "./viewer_workers.js";

/** Fills a layer from a PLY of 3DGS training. */
export class PlyFeed implements SceneFeed {
  readonly progressive = false;
  readonly hasFirstView = false;
  private layer: SplatLayer | undefined;

  /**
   * @param source - A URL or a file.
   * @param workers - Makes the worker that reads; undefined reads on the caller's thread.
   * @param mostSplats - Rows beyond are not read.
   */
  constructor(
    private readonly source: string | Blob,
    private readonly workers: ViewerWorkers | undefined,
    private readonly mostSplats: number,
  ) {}

  async run(host: FeedHost, signal: AbortSignal): Promise<void> {
    const request: PlyRequest = { type: "ply", source: this.source, mostRows: this.mostSplats, ranges: DEFAULT_RANGES };
    let splats = 0;
    let totalSplats = 0;
    let totalBytes: number | undefined;
    await new Promise<void>((resolve, reject) => {
      const worker = this.workers?.viewer();
      const stop = (): void => {
        worker?.terminate();
        reject(signal.reason as Error);
      };
      signal.addEventListener("abort", stop, { once: true });
      const take = (response: PlyResponse): void => {
        if (signal.aborted) return;
        if (response.type === "scene") {
          const { scene } = response;
          totalSplats = scene.splats;
          totalBytes = response.totalBytes;
          const info = { axes: scene.axes, box: [-1, -1, -1, 1, 1, 1], firstView: undefined, origin: scene.fileOrigin };
          this.layer = host.begin(scene, info);
        } else if (response.type === "rows") {
          splats += response.packed.count;
          host.rowsCame(response.packed, response.firstRow === 0);
          this.layer!.write(response.packed, response.firstRow);
          host.progressed({ splats, totalSplats, bytes: response.bytes, totalBytes, predictedDb: undefined });
        } else {
          signal.removeEventListener("abort", stop);
          worker?.terminate();
          if (response.type === "end") resolve();
          else reject(response.status === undefined ? new Error(response.message) : new SourceError(response.message, response.status));
        }
      };
      if (worker === undefined) {
        void readPly(request, take);
        return;
      }
      worker.onmessage = ({ data }: MessageEvent<PlyResponse>) => take(data);
      worker.onerror = (event) => reject(new Error(`a worker failed: ${event.message}`));
      worker.postMessage(request);
    });
  }

  prefixes(): Prefix[] {
    // The rows of a PLY are in no order that would make a part of them a picture.
    return [];
  }

  show(): void {
    this.layer?.limit(Infinity);
  }

  work(): boolean {
    return false;
  }
}
