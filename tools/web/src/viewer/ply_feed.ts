import { SourceError } from "../errors.js";
import type { ByteSource } from "../loader/byte_source.js";
import { DEFAULT_RANGES } from "../scene/packed_splats.js";
import { failureText } from "../workers/worker_start.js";
import type { Meter } from "./meter.js";
import type { PlyRequest, PlyResponse, RateRequest } from "./ply_messages.js";
import { readPly } from "./ply_reader.js";
import type { FeedHost, Prefix, SceneFeed } from "./scene_feed.js";
import { pathOf } from "./scene_name.js";
import type { SplatLayer } from "./splat_layer.js";
import type { AllowedWorkers } from "./viewer_workers.js";

/** Fills a layer from a PLY of 3DGS training. */
export class PlyFeed implements SceneFeed {
  readonly progressive = false;
  readonly firstView = undefined;
  private layer: SplatLayer | undefined;

  /**
   * @param source - A URL or a file.
   * @param meter - Counts the bytes and limits their rate.
   * @param workers - Workers for reading; without them rows are read on this thread, block by block.
   * @param mostSplats - Rows to read at most.
   */
  constructor(
    private readonly source: string | Blob,
    private readonly meter: Meter,
    private readonly workers: AllowedWorkers,
    private readonly mostSplats: number,
  ) {}

  async run(host: FeedHost, signal: AbortSignal): Promise<void> {
    const allowed = await this.workers.found;
    this.workers.close();
    signal.throwIfAborted();
    const { meter } = this;
    let { bitsPerSecond } = meter;
    const request: PlyRequest = {
      type: "ply",
      source: this.source,
      mostRows: this.mostSplats,
      ranges: DEFAULT_RANGES,
      bitsPerSecond,
    };
    let splats = 0;
    let totalSplats = 0;
    let totalBytes: number | undefined;
    await new Promise<void>((resolve, reject) => {
      const worker = allowed?.viewer();
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
          const info = {
            axes: scene.axes,
            box: [-1, -1, -1, 1, 1, 1],
            firstView: undefined,
            origin: scene.origin,
            levels: [],
          };
          this.layer = host.begin({ ...scene, hasLevels: false }, info);
        } else if (response.type === "rows") {
          splats += response.packed.count;
          // The rate may change while rows arrive.
          if (worker !== undefined && bitsPerSecond !== meter.bitsPerSecond) {
            bitsPerSecond = meter.bitsPerSecond;
            worker.postMessage({ type: "rate", bitsPerSecond } satisfies RateRequest);
          }
          host.rowsArrived(response.packed, response.firstRow === 0);
          this.layer!.write(response.packed, response.firstRow);
          host.progressed({ splats, totalSplats, bytes: response.bytes, totalBytes, predictedDb: undefined });
        } else {
          signal.removeEventListener("abort", stop);
          worker?.terminate();
          if (response.type === "end") resolve();
          else
            reject(
              response.status === undefined
                ? new Error(response.message)
                : new SourceError(response.message, response.status),
            );
        }
      };
      if (worker === undefined) {
        void readPly(request, meter, take, () => new Promise((next) => setTimeout(next, 0)));
        return;
      }
      worker.onmessage = ({ data }: MessageEvent<PlyResponse>) => take(data);
      worker.onerror = (event) => reject(new Error(failureText(event.message, allowed!.address)));
      worker.postMessage(request);
    });
  }

  prefixes(): Prefix[] {
    // The rows of a PLY are in arbitrary order, so a part of them is no picture.
    return [];
  }

  show(): void {
    this.layer?.limit(Infinity);
  }

  drawLevel(): undefined {
    return undefined;
  }

  work(): boolean {
    return false;
  }
}

/** Return the source if it is a PLY: by the name of a URL, by the first bytes of a file. */
export async function plyOf(source: string | Blob | ByteSource): Promise<string | Blob | undefined> {
  if (typeof source === "string") {
    return pathOf(source).toLowerCase().endsWith(".ply") ? source : undefined;
  }
  if (!(source instanceof Blob)) return undefined;
  const beginning = new TextDecoder("latin1").decode(await source.slice(0, 4).arrayBuffer());
  return /^ply[\r\n]/.test(beginning) ? source : undefined;
}
