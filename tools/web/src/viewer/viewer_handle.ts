import type { Pinhole } from "../container/pinhole.js";

/** State of a viewer, for the page around it and for tests. */
export interface ViewerStatistics {
  /**
   * `complete`: the scene or, with a smaller budget, all chunks chosen for the view have arrived. `failed`: `error` is
   * shown; a truncated scene stays on the canvas.
   */
  readonly state: "empty" | "opening" | "streaming" | "complete" | "failed";
  /** Splats received and in memory. */
  readonly splats: number;
  /** Splats of the last picture. */
  readonly drawnSplats: number;
  /** Splats of the scene; 0 until its root has been read. */
  readonly totalSplats: number;
  /** Bytes received. */
  readonly bytes: number;
  /** Length of the file, if known. */
  readonly totalBytes?: number;
  /** PSNR that the file predicts for the part received, dB, if any. */
  readonly predictedDb?: number;
  /**
   * Level drawn, as far as it has arrived: 1.25 is a quarter of the way from level 1 to level 2; only of scenes with
   * levels.
   */
  readonly level?: number;
  /** Number of pictures drawn of this scene. */
  readonly frames: number;
  /** Duration of the last picture on the main thread and of the last sort in its worker, ms. */
  readonly drawMilliseconds: number;
  readonly sortMilliseconds: number;
  /** Duration of a picture, from its first command to the end of its graphics work, ms. */
  readonly pictureMilliseconds: number;
  /** Whether the canvas shows all rows received, in the requested view at full resolution. */
  readonly upToDate: boolean;
  /** Message shown to the person, where `state` is `failed`. */
  readonly error?: string;
}

/** Statistics of a viewer without a scene. */
export const NO_STATISTICS: ViewerStatistics = {
  state: "empty",
  splats: 0,
  drawnSplats: 0,
  totalSplats: 0,
  bytes: 0,
  frames: 0,
  drawMilliseconds: 0,
  pictureMilliseconds: 0,
  sortMilliseconds: 0,
  upToDate: false,
};

/**
 * A pose and its focal lengths, pixels of a picture of this height; they are scaled to the canvas. Turning goes around
 * the target.
 */
export type ViewerPose = Pick<Pinhole, "height" | "fx" | "fy" | "rotation" | "translation"> &
  Partial<Pick<Pinhole, "width" | "target">>;

/** Interface of a viewer for programs of the page: `window.cogsplatViewer`, and every `<cogsplat-viewer>`. */
export interface ViewerHandle {
  readonly statistics: ViewerStatistics;
  /**
   * Pose of the camera, in the space of the means; undefined before a scene is open. Setting it moves the camera, and
   * applies to later scenes too.
   */
  view: ViewerPose | undefined;
  /** Pose as text, which the attribute `view` and the command line's `--view` take. */
  readonly viewText: string | undefined;
  /** Whether holes between splats are filled while a scene arrives; without it pictures are exact. */
  fillHoles: boolean;
}

declare global {
  interface Window {
    cogsplatViewer?: ViewerHandle;
  }
}
