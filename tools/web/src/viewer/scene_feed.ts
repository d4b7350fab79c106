import type { SceneInfo } from "../container/root.js";
import type { PackedSplats } from "../scene/packed_splats.js";
import type { Pose } from "../schedule/poses.js";
import type { LayerScene, SplatLayer } from "./splat_layer.js";

/** How far a scene has come. */
export interface FeedProgress {
  readonly splats: number;
  readonly totalSplats: number;
  readonly bytes: number;
  /** Length of the file; undefined where the server does not say. */
  readonly totalBytes: number | undefined;
  /** PSNR that the file predicts for what has come, dB; undefined where it predicts nothing. */
  readonly predictedDb: number | undefined;
}

/** A part of a scene that could be shown alone: what the first bytes hold. */
export interface Prefix {
  /** Rows from the first on. */
  readonly rows: number;
  /** Chunks from the first on. */
  readonly chunks: number;
  /** Bytes of those chunks, and of what comes before them. */
  readonly bytes: number;
  readonly predictedDb: number | undefined;
}

/** What a feed asks of the viewer that it fills. */
export interface FeedHost {
  /**
   * Make the layer of a scene; called once, before rows come.
   *
   * @param scene - The means of its rows are relative to its origin.
   * @param info - Poses are relative to its origin.
   */
  begin(scene: LayerScene, info: Pick<SceneInfo, "axes" | "box" | "firstView" | "origin" | "levels">): SplatLayer;
  /** Told of rows when they are in the layer. */
  rowsCame(packed: PackedSplats, first: boolean): void;
  progressed(progress: FeedProgress): void;
  /** All that the pose is worth has come, or something of it is missing again. */
  settled(isSettled: boolean): void;
  /** Something cannot be had, and the rest goes on being shown. */
  damaged(error: unknown): void;
}

/** Fills a layer with one scene. */
export interface SceneFeed {
  /** Whether what has come first is a picture of the whole, so that it is shown before the rest is there. */
  readonly progressive: boolean;
  /** Whether the file says where to look from. */
  readonly hasFirstView: boolean;
  /** Resolves when all has come; where a part could not be had or used, it rejects after all else is shown. */
  run(host: FeedHost, signal: AbortSignal): Promise<void>;
  /** Prefixes to choose from, about `count` of them, from the smallest to the whole. */
  prefixes(count: number): Prefix[];
  /** Show the layer as it is with a prefix alone; undefined shows all that is there. */
  show(prefix: Prefix | undefined): void;
  /**
   * Draw the level for a size, or one that was chosen, as far as it has come (SPEC 8.11).
   *
   * @param focal - Focal length of the picture, px.
   * @param chosen - 0 the coarsest; 1.25 is a quarter of the way from level 1 to level 2. Undefined for that of the size.
   * @returns The level that is drawn; undefined for a scene without levels.
   */
  drawLevel(focal: number, chosen: number | undefined): number | undefined;
  /**
   * Look from somewhere, in the space of the means, where that says what is fetched; asked as soon as it has changed.
   */
  look?(pose: Pose): void;
  /** Hold at most so many splats; returns whether the feed sees to it. */
  limit?(splats: number): boolean;
  /** Work of at most some ms; returns whether there is more. */
  work(milliseconds: number): boolean;
}
