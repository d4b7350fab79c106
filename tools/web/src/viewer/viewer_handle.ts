import type { Pinhole } from "../container/pinhole.js";

/** How far a viewer is, for pages around it and for tests. */
export interface ViewerStatistics {
  /** `complete` where all of the scene is there or, with a budget below it, all that the view is worth; `failed` where `error` is shown; a scene that was cut off stays on the canvas as far as it has come. */
  readonly state: "empty" | "opening" | "streaming" | "complete" | "failed";
  /** Splats that have arrived and are in memory. */
  readonly splats: number;
  /** Splats of the scene; 0 until its root has been read. */
  readonly totalSplats: number;
  /** Bytes that have arrived. */
  readonly bytes: number;
  /** Length of the file, where it is known. */
  readonly totalBytes?: number;
  /** PSNR that the file predicts for what has arrived, dB; only where it does. */
  readonly predictedDb?: number;
  /** The level that is drawn, as far as it has arrived: 1.25 is a quarter of the way from level 1 to level 2; only of scenes with levels. */
  readonly level?: number;
  /** Pictures drawn of this scene. */
  readonly frames: number;
  /** Duration of the last picture on the main thread and of the last sort in its worker, ms. */
  readonly drawMilliseconds: number;
  readonly sortMilliseconds: number;
  /** Duration of a picture, from its first command until the graphics had finished it, ms. */
  readonly pictureMilliseconds: number;
  /** Whether the canvas shows all that has arrived, in the view asked for and in all its pixels. */
  readonly upToDate: boolean;
  /** The sentence that a person is shown, where `state` is `failed`. */
  readonly error?: string;
}

/** A pose and its focal lengths, px of a picture of this height; they are scaled to the canvas. */
export type ViewerPose = Pick<Pinhole, "height" | "fx" | "fy" | "rotation" | "translation"> &
  Partial<Pick<Pinhole, "width">>;

/** What a page's program can ask of its viewer, as `window.cogsplatViewer`; every `<cogsplat-viewer>` has it. */
export interface ViewerHandle {
  readonly statistics: ViewerStatistics;
  /** Look from somewhere, in the space of the means, until a person moves; it holds for scenes to come as well. */
  view: ViewerPose | undefined;
  /** Whether holes between splats take the colour around them while a scene arrives; without it pictures are exact. */
  fillHoles: boolean;
}

declare global {
  interface Window {
    cogsplatViewer?: ViewerHandle;
  }
}
