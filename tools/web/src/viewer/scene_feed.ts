import type { Description, PictureName } from "../container/description.js";
import type { Pinhole } from "../container/pinhole.js";
import type { SceneInfo } from "../container/root.js";
import type { PackedSplats } from "../scene/packed_splats.js";
import type { Pose } from "../schedule/poses.js";
import type { OrbitScene } from "./orbit.js";
import type { LayerScene, SplatLayer } from "./splat_layer.js";

/** Progress of a scene. */
export interface FeedProgress {
  readonly splats: number;
  readonly totalSplats: number;
  readonly bytes: number;
  /** Length of the file; undefined where the server does not state it. */
  readonly totalBytes: number | undefined;
  /** PSNR that the file predicts for the part received, dB; undefined for files without a prediction. */
  readonly predictedDb: number | undefined;
}

/** A beginning of the file that can be shown without the rest. */
export interface Prefix {
  /** Number of rows. */
  readonly rows: number;
  /** Number of chunks. */
  readonly chunks: number;
  /** Bytes up to the end of the last chunk. */
  readonly bytes: number;
  readonly predictedDb: number | undefined;
}

/** Functions of a viewer that its feed calls. */
export interface FeedHost {
  /**
   * Make the layer of a scene; called once, before any rows.
   *
   * @param scene - Layer scene; the means of its rows are relative to its origin.
   * @param info - Scene information; poses are relative to its origin.
   */
  begin(scene: LayerScene, info: OrbitScene & Pick<SceneInfo, "origin" | "levels">): SplatLayer;
  /** Called when rows are in the layer. */
  rowsArrived(packed: PackedSplats, first: boolean): void;
  progressed(progress: FeedProgress): void;
  /** Called when all chunks that the pose is worth have arrived, or some are missing again. */
  settled(isSettled: boolean): void;
  /** Called when a part cannot be fetched or decoded; the rest stays visible. */
  damaged(error: unknown): void;
}

/** Source of a scene's description and pictures. */
export interface DescriptionSource {
  /** Aborted when another scene is loaded. */
  readonly signal: AbortSignal;
  description(): Promise<Description | undefined>;
  picture(name: PictureName): Promise<Blob | undefined>;
}

/** Fills a layer with one scene. */
export interface SceneFeed {
  /** Source of the scene's description; undefined without one, and before the scene is open. */
  readonly descriptionSource?: DescriptionSource | undefined;
  /** Whether the first rows show the whole scene coarsely, so that they are drawn before the rest arrives. */
  readonly progressive: boolean;
  /** First view of the file, if any. */
  readonly firstView: Pinhole | undefined;
  /** Run to the end; reject at the end if a part could not be fetched or decoded. */
  run(host: FeedHost, signal: AbortSignal): Promise<void>;
  /** Return about `count` prefixes, from the smallest to the whole file. */
  prefixes(count: number): Prefix[];
  /** Show only a prefix; undefined shows all rows received. */
  show(prefix: Prefix | undefined): void;
  /**
   * Draw the level for a picture size, or a chosen one, as far as it has arrived (SPEC 8.11).
   *
   * @param focal - Focal length of the picture, pixels.
   * @param chosen - 0 the coarsest; 1.25 is a quarter of the way from level 1 to level 2. By default by the size.
   * @returns The level drawn; undefined for a scene without levels.
   */
  drawLevel(focal: number, chosen: number | undefined): number | undefined;
  /** Set the pose, in the space of the means, for feeds that fetch by the view. */
  setPose?(pose: Pose): void;
  /** Limit the splats held; return whether the feed supports it. */
  setSplatBudget?(splats: number): boolean;
  /** Work for at most some ms; return whether more is left. */
  work(milliseconds: number): boolean;
}
