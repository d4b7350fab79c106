import type { ByteSource } from "../loader/byte_source.js";
import { DEFAULT_RANGES } from "../scene/packed_splats.js";
import { CogsFeed, type FetchOrder } from "./cogs_feed.js";
import { DepthSorter } from "./depth_sorter.js";
import type { Meter } from "./meter.js";
import { PlyFeed } from "./ply_feed.js";
import type { FeedHost, SceneFeed } from "./scene_feed.js";
import { type LayerScene, SplatLayer } from "./splat_layer.js";
import { AllowedWorkers, type ViewerWorkers } from "./viewer_workers.js";

/** A URL, a file, or another source of the bytes of a `.cogs` file. */
export type SceneSource = string | Blob | ByteSource;

/** Meter, workers, budget and fetch order of a scene to load. */
export interface LoadOptions {
  /** Counts the bytes and limits their rate. */
  readonly meter: Meter;
  readonly workers: ViewerWorkers | undefined;
  /** Splats in memory at most. */
  readonly budget: number;
  /** Fetch order of a `.cogs` file. */
  readonly order: FetchOrder;
}

/** A scene on a canvas: its feed, its layer once it is open, and its workers. */
export class ShownScene {
  readonly feed: SceneFeed;
  /** Splats in memory at most. */
  budget: number;
  layer: SplatLayer | undefined;
  private readonly workers: AllowedWorkers;
  private readonly abort = new AbortController();

  /** @param ply - The source where it is a PLY; undefined for a `.cogs` file. */
  constructor(source: SceneSource, ply: string | Blob | undefined, { meter, workers, budget, order }: LoadOptions) {
    this.budget = budget;
    this.workers = new AllowedWorkers(workers);
    this.feed =
      ply !== undefined
        ? new PlyFeed(ply, meter, this.workers, budget)
        : new CogsFeed(source, meter, this.workers, budget, order);
  }

  /** Load the scene to its end; reject at the end if a part could not be fetched or decoded. */
  async run(host: FeedHost): Promise<void> {
    await this.feed.run(host, this.abort.signal);
  }

  /**
   * Make the layer, in place of an earlier one.
   *
   * @param capacity - Splats in memory at most.
   * @param changed - Called when a new picture is needed.
   * @param failed - Called when rows cannot be sorted.
   */
  makeLayer(
    gl: WebGL2RenderingContext,
    scene: LayerScene,
    capacity: number,
    changed: () => void,
    failed: (error: Error) => void,
  ): SplatLayer {
    this.layer?.close();
    const sorter = (rows: number): DepthSorter =>
      new DepthSorter(rows, this.workers.known, (message) => failed(new Error(message)));
    this.layer = new SplatLayer(gl, scene, DEFAULT_RANGES, capacity, sorter, changed);
    return this.layer;
  }

  /**
   * Free the memory of splats beyond a budget.
   *
   * @returns Whether that is possible: rows of a scene in view order are anywhere in memory.
   */
  release(budget: number): boolean {
    if (this.layer === undefined || this.feed.setSplatBudget?.(budget) === true) return false;
    this.budget = budget;
    this.layer.release(budget);
    return true;
  }

  get isClosed(): boolean {
    return this.abort.signal.aborted;
  }

  /** End loading, and free layer and workers. */
  close(): void {
    this.abort.abort();
    this.layer?.close();
    this.workers.close();
  }
}
