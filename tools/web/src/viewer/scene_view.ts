import type { LevelEntry } from "../container/root.js";
import type { ByteSource } from "../loader/byte_source.js";
import { DEFAULT_RANGES } from "../scene/packed_splats.js";
import { millisecondsLeft } from "./arrival_forecast.js";
import { CogsFeed, type FetchOrder } from "./cogs_feed.js";
import { Controls, type ControlsHost } from "./controls.js";
import { DepthSorter } from "./depth_sorter.js";
import { bulkOf, depthAhead } from "./framing.js";
import { Meter } from "./meter.js";
import { OrbitCamera, type Vector } from "./orbit.js";
import { PicturePace } from "./picture_pace.js";
import { PlyFeed, plyOf } from "./ply_feed.js";
import { type EyeTarget, type PictureOptions, SplatRenderer, type View } from "./renderer.js";
import type { DescriptionSource, FeedHost, FeedProgress, Prefix, SceneFeed } from "./scene_feed.js";
import { SplatLayer } from "./splat_layer.js";
import { poseOf, type ViewText } from "./view_text.js";
import type { ViewerPose, ViewerStatistics } from "./viewer_handle.js";
import { AllowedWorkers, type ViewerWorkers } from "./viewer_workers.js";

/** A URL, a file, or another source of the bytes of a `.cogs` file. */
export type SceneSource = string | Blob | ByteSource;

/** Longest work on compensation between two pictures, ms: a frame has 16. */
const WORK_MILLISECONDS = 5;
/** Time after the last change at which slow graphics draw at full resolution although more is to arrive, ms. */
const QUIET_MILLISECONDS = 300;
/** Interval at which the GPU is polled for the end of a picture, ms. */
const LOOK_MILLISECONDS = 4;

/** Time without a change of the pose after which the view rests, ms. */
const REST_MILLISECONDS = 200;

/** Moves the camera with each picture until it returns false or a person moves; the time since the last one is in s. */
export type Motion = (camera: OrbitCamera, seconds: number) => boolean;

/** Where the camera starts, in place of the scene's first view. */
export interface Start {
  readonly view?: ViewText | undefined;
  readonly up?: Vector | undefined;
  /** Point that turning goes around. */
  readonly target?: Vector | undefined;
}

/** Callbacks of a scene view. */
export interface SceneViewHost extends Pick<ControlsHost, "leavesScrolling" | "left" | "tapped"> {
  /** Called when the camera has come to rest in another pose. */
  rested(): void;
  /** Called when the first rows of a scene that has a description are there. */
  described(source: DescriptionSource): void;
  /** Called after each picture. */
  drawn(): void;
  /** Called when a motion has ended; by a person or by itself. */
  motionEnded(byPerson: boolean): void;
  /** Called when the statistics or the canvas have changed. */
  changed(): void;
  /** Called on an error of a scene, of the second scene or of WebGL. */
  failed(error: unknown, which: "scene" | "other" | "graphics"): void;
  /** Called when lost graphics are back. */
  restored(): void;
}

/** Share of the splats wanted below which a scene is loaded again for them. */
const TOO_FEW = 0.75;

/** One of the two scenes shown. */
interface Shown {
  /** Splats in memory at most, when it was loaded. */
  readonly budget: number;
  readonly feed: SceneFeed;
  readonly abort: AbortController;
  readonly workers: AllowedWorkers;
  layer?: SplatLayer;
}

const EMPTY: ViewerStatistics = {
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

/** Shows a scene, and optionally a second one, on a canvas: loads it, moves the camera, draws on demand. */
export class SceneView {
  readonly controls: Controls;
  readonly meter = new Meter();
  statistics: ViewerStatistics = EMPTY;
  /** Axes of the scene. */
  axes = "RDF";
  /** Highest SH degree of the scene. */
  degree = 3;
  /** Maximum number of device pixels per CSS pixel. */
  mostPixelRatio = 2;
  /** Device pixels per CSS pixel in place of the screen's. */
  pixelRatio: number | undefined;
  /** Levels of the scene, coarsest first; empty without levels. */
  levels: readonly LevelEntry[] = [];
  /** Whether slow graphics draw moving and arriving pictures at reduced resolution. */
  allowsLowResolution = true;
  /** Fetch order of scenes loaded later. */
  order: FetchOrder;
  private readonly renderer: SplatRenderer;
  private readonly pace: PicturePace;
  private readonly abort = new AbortController();
  private readonly observer: ResizeObserver;
  private main: Shown | undefined;
  private other: Shown | undefined;
  private camera: OrbitCamera | undefined;
  /** World position of the zero of poses. */
  private origin: readonly number[] = [0, 0, 0];
  /** Sets the initial pose, for `reset`. */
  private home: ((camera: OrbitCamera) => void) | undefined;
  private homeCamera: (() => OrbitCamera) | undefined;
  private pose: ViewerPose | undefined;
  private start: Start = {};
  private touched = false;
  /** Numbers of the scenes loaded, so that a scene replaced before its start does not start. */
  private readonly runs = { main: 0, other: 0 };
  private scheduled = false;
  private dirty = false;
  private lost = false;
  /** Whether a headset's frames draw in place of the browser's. */
  private isPresenting = false;
  private lastFrame = 0;
  private lastChange = 0;
  /** Whether the last picture has full resolution and shows all rows received. */
  private isSharp = true;
  private isWhole = true;
  /** Splats in memory at most: chosen, and the share of the page's budget. */
  private chosenBudget = Infinity;
  private sharedBudget = Infinity;
  /** Whether the first view has been completely received; from then on holes stay and no picture waits. */
  private wasSettled = false;
  /** Last pose passed to the feeds. */
  private looked = "";
  /** Last pose of the camera, and the timer that reports its rest. */
  private seen = "";
  private resting: ReturnType<typeof setTimeout> | undefined;
  private motion: Motion | undefined;
  private visible = true;
  private isFree = false;
  private source: SceneSource | undefined;
  /** Rows of the picture that stays while the scene is loaded again; 0 otherwise. */
  private keptRows = 0;
  /** Whether a person has moved the camera since the scene began to load again. */
  private hasMoved = false;
  private readonly waiting: (() => void)[] = [];
  private picture: PictureOptions = { background: [0, 0, 0, 1], degree: 3, fill: 0, divide: 0.5 };
  private fills = true;
  private chosenLevel: number | undefined;
  /** Level of the second scene that was drawn last. */
  private otherLevel: number | undefined;

  /** @throws NoWebGlError where the browser has no WebGL 2. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly host: SceneViewHost,
    private readonly workers: ViewerWorkers | undefined,
  ) {
    this.renderer = new SplatRenderer(canvas);
    this.pace = new PicturePace(this.renderer.gl);
    const { signal } = this.abort;
    this.controls = new Controls(
      canvas,
      {
        camera: () => this.camera,
        touched: () => this.endMotion(true),
        moved: () => {
          this.touched = this.hasMoved = true;
          this.redraw();
        },
        leavesScrolling: () => host.leavesScrolling(),
        left: (input) => host.left(input),
        tapped: (x, y, isDouble) => host.tapped(x, y, isDouble),
      },
      signal,
    );
    this.observer = new ResizeObserver(() => this.redraw());
    this.observer.observe(canvas);
    canvas.addEventListener(
      "webglcontextlost",
      (event) => {
        event.preventDefault();
        this.lost = true;
        this.updateStatistics({ upToDate: false });
        host.failed(undefined, "graphics");
      },
      { signal },
    );
    canvas.addEventListener(
      "webglcontextrestored",
      () => {
        this.lost = false;
        this.pace.forget();
        this.renderer.restore();
        for (const layer of this.layers) layer.restore();
        host.restored();
        this.redraw();
      },
      { signal },
    );
  }

  /** Whether a part of the scene is on the canvas. */
  get isShown(): boolean {
    return (
      (this.main?.layer?.drawnRows ?? 0) > 0 && (this.main!.feed.progressive || this.statistics.state !== "streaming")
    );
  }

  /** Whether a second scene is shown. */
  get compares(): boolean {
    return this.other !== undefined;
  }

  /** Rows of the last picture. */
  get drawnRows(): number {
    return this.main?.layer?.drawnRows ?? 0;
  }

  get fillHoles(): boolean {
    return this.fills;
  }

  set fillHoles(fills: boolean) {
    this.fills = fills;
    this.redraw();
  }

  /**
   * Level chosen, 0 the coarsest, or a number between two; undefined for the level of the picture's size (SPEC 8.11).
   */
  get level(): number | undefined {
    return this.chosenLevel;
  }

  set level(level: number | undefined) {
    this.chosenLevel = level;
    this.redraw();
  }

  /** Whether turning may go anywhere: over the poles and below the ground too. */
  set orbitsFreely(isFree: boolean) {
    this.isFree = isFree;
    if (this.camera !== undefined) this.camera.isFree = isFree;
  }

  /** Pose of the camera; before a scene is open the one that was set, which applies to later scenes too. */
  get view(): ViewerPose | undefined {
    const { camera } = this;
    if (camera === undefined) return this.pose;
    const [width, height] = this.size(1);
    const { rotation, translation, focal } = camera.view(height, width);
    return { width, height, fx: focal[0], fy: focal[1], rotation, translation, target: camera.target };
  }

  set view(view: ViewerPose | undefined) {
    this.endMotion(true);
    this.pose = view;
    if (view !== undefined) this.camera?.setPose(view);
    this.redraw();
  }

  /** Context that draws the scene. */
  get gl(): WebGL2RenderingContext {
    return this.renderer.gl;
  }

  /** Packed rows of the scene, and what to add to a point in the space of the poses for that of the rows' means. */
  get packed(): { readonly words: Uint32Array; readonly rows: number; readonly shift: Vector } | undefined {
    const layer = this.main?.layer;
    if (layer === undefined) return undefined;
    const shift = this.origin.map((value, axis) => value - layer.scene.origin[axis]!) as Vector;
    return { words: layer.words, rows: layer.rows, shift };
  }

  /** Direction against gravity; undefined before a scene is open. */
  get up(): Vector | undefined {
    return this.camera?.up;
  }

  /** Text of the camera's pose; undefined before a scene is open. */
  get viewText(): string | undefined {
    const { camera } = this;
    if (camera === undefined) return undefined;
    const [width, height] = this.size(1);
    return camera.text(height, width);
  }

  /** Change where the camera starts, and go there. */
  startFrom(start: Start): void {
    this.start = { ...this.start, ...start };
    this.reset();
  }

  /** Whether the canvas can be seen; motions wait until it is. */
  set isVisible(visible: boolean) {
    this.visible = visible;
    if (this.motion !== undefined) this.redraw();
  }

  /** Whether a motion moves the camera. */
  get isMoving(): boolean {
    return this.motion !== undefined;
  }

  /** Move the camera by a motion, in place of any other. */
  move(motion: Motion): void {
    this.endMotion(false);
    this.motion = motion;
    this.redraw();
  }

  /** End the motion, if any. */
  endMotion(byPerson: boolean): void {
    if (this.motion === undefined) return;
    this.motion = undefined;
    this.host.motionEnded(byPerson);
  }

  /** Options of pictures. */
  get options(): PictureOptions {
    return this.picture;
  }

  /** Change options of pictures. */
  show(options: Partial<Omit<PictureOptions, "fill">>): void {
    this.picture = { ...this.picture, ...options };
    this.redraw();
  }

  /** Limit the splats drawn: the first of the file or, in view order, the splats worth most to the view. */
  limit(splats: number): void {
    this.chosenBudget = splats;
    this.applyBudget();
  }

  /**
   * Limit the splats to the viewer's share of the page's budget.
   *
   * Without any the scene's memory is given back, and with many more the scene is loaded again; the canvas keeps its
   * picture meanwhile.
   */
  share(splats: number): void {
    this.sharedBudget = splats;
    const { main, source } = this;
    if (source === undefined || this.compares || this.statistics.state === "failed") {
      this.applyBudget();
      return;
    }
    const most = Math.min(main?.layer?.scene.splats ?? Infinity, this.budget);
    if (splats > 0 && main !== undefined && main.budget >= TOO_FEW * most) {
      this.applyBudget();
      return;
    }
    this.keptRows = Math.max(this.drawnRows, this.keptRows);
    this.hasMoved = false;
    this.close("main");
    this.meter.reset();
    this.wasSettled = false;
    if (splats > 0) void this.run("main", source);
  }

  private get budget(): number {
    return Math.min(this.chosenBudget, this.sharedBudget);
  }

  private applyBudget(): void {
    const splats = this.budget;
    for (const shown of [this.main, this.other]) {
      if (!(shown?.feed.setSplatBudget?.(splats) ?? false)) shown?.layer?.limit(splats);
    }
  }

  /** Replace the scene. */
  async load(source: SceneSource): Promise<void> {
    this.source = source;
    this.keptRows = 0;
    this.endMotion(true);
    this.close("main");
    this.close("other");
    this.camera = undefined;
    this.touched = false;
    this.meter.reset();
    this.wasSettled = false;
    this.statistics = { ...EMPTY, state: "opening" };
    this.host.changed();
    // Out of sight of a page whose budget is used up the scene waits for a share.
    if (this.sharedBudget > 0) await this.run("main", source);
  }

  /** Show a second scene left of the divide; undefined removes it. */
  async compare(source: SceneSource | undefined): Promise<void> {
    this.close("other");
    this.redraw();
    if (source !== undefined) await this.run("other", source);
  }

  /** Return to the first view. */
  reset(): void {
    this.endMotion(true);
    this.camera = this.homeCamera?.();
    if (this.camera !== undefined) {
      this.camera.isFree = this.isFree;
      this.home?.(this.camera);
      const { view, target } = this.start;
      if (view !== undefined) this.camera.setPose(poseOf(view, this.camera.up));
      if (this.pose !== undefined) this.camera.setPose(this.pose);
      if (target !== undefined) this.camera.setPose({ ...this.view!, target });
    }
    this.touched = false;
    this.redraw();
  }

  /** Return the prefixes of the file that can be shown. */
  prefixes(count: number): Prefix[] {
    return this.main?.feed.prefixes(count) ?? [];
  }

  /** Show a prefix of the file; undefined shows all rows received. */
  showPrefix(prefix: Prefix | undefined): void {
    this.main?.feed.show(prefix);
    if (prefix === undefined) this.applyBudget();
    this.redraw();
  }

  /** Leave the drawing to `drawEyes`; the function returned draws on the canvas again, in the pose before. */
  present(): () => void {
    this.endMotion(true);
    const before = this.view;
    this.isPresenting = true;
    return () => {
      this.isPresenting = false;
      if (before !== undefined) this.camera?.setPose(before);
      this.redraw();
    };
  }

  /** Draw the rows received for each eye of a head. */
  drawEyes(head: ViewerPose, eyes: readonly { readonly view: View; readonly target: EyeTarget }[]): void {
    const { camera, renderer, main } = this;
    if (camera === undefined || main?.layer === undefined || this.lost) return;
    camera.setPose(head);
    this.passPose();
    main.feed.work(WORK_MILLISECONDS);
    if (!this.canDraw()) return;
    this.drawLevels(head.fy);
    main.layer.upload();
    const options = { ...this.picture, fill: 0 };
    for (const { view, target } of eyes) renderer.draw({ ...view, origin: this.origin }, [main.layer], options, target);
  }

  /** Resolve when the canvas shows all rows received in the requested view. */
  async settled(): Promise<void> {
    this.redraw();
    await new Promise<void>((resolve) => this.waiting.push(resolve));
  }

  /** Draw a picture with the next frame of the browser. */
  readonly redraw = (): void => {
    this.dirty = true;
    this.lastChange = performance.now();
    if (this.statistics.upToDate) this.updateStatistics({ upToDate: false });
    this.schedule();
  };

  /** End loading, workers and drawing, and give the memory back. */
  dispose(): void {
    this.abort.abort();
    clearTimeout(this.resting);
    this.observer.disconnect();
    this.close("main");
    this.close("other");
    this.renderer.close();
    this.renderer.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  private get layers(): SplatLayer[] {
    return [this.main?.layer, this.other?.layer].filter((layer) => layer !== undefined);
  }

  private async run(which: "main" | "other", source: SceneSource): Promise<void> {
    const abort = new AbortController();
    const isMain = which === "main";
    const run = ++this.runs[which];
    const ply = await plyOf(source);
    if (run !== this.runs[which]) return;
    const workers = new AllowedWorkers(this.workers);
    const meter = isMain ? this.meter : new Meter();
    const feed =
      ply !== undefined
        ? new PlyFeed(ply, meter, workers, this.budget)
        : new CogsFeed(source, meter, workers, this.budget, this.order);
    const shown: Shown = { budget: this.budget, feed, abort, workers };
    this[which] = shown;
    try {
      await feed.run(isMain ? this.mainHost(shown) : this.otherHost(shown), abort.signal);
      if (isMain) this.updateStatistics({ state: "complete" });
      this.redraw();
    } catch (error) {
      if (abort.signal.aborted) return;
      if (isMain) this.updateStatistics({ state: "failed" });
      else this.close("other");
      this.host.failed(error, isMain ? "scene" : "other");
      this.redraw();
    }
  }

  private mainHost(shown: Shown): FeedHost {
    return {
      begin: (scene, info) => {
        this.axes = info.axes;
        this.degree = scene.shDegree;
        this.levels = info.levels;
        this.origin = info.origin;
        this.homeCamera = () => new OrbitCamera({ ...info, ...(this.start.up && { up: this.start.up }) });
        this.home = undefined;
        const pose = this.keptRows > 0 ? this.view : undefined;
        this.reset();
        if (pose !== undefined) {
          this.camera!.setPose(pose);
          this.touched = true;
        }
        this.updateStatistics({ state: "streaming", totalSplats: scene.splats });
        shown.layer?.close();
        shown.layer = this.makeLayer(scene, shown.workers.known);
        return shown.layer;
      },
      rowsArrived: (packed, first) => {
        const { descriptionSource } = shown.feed;
        if (first && descriptionSource !== undefined) this.host.described(descriptionSource);
        const { firstView } = shown.feed;
        if (!first || this.camera === undefined || firstView?.target !== undefined) return;
        // Without a first view with a target, the first splats show where to stand or what to turn around.
        const { position, forward } = this.camera;
        const shift = this.origin.map((value, axis) => value - shown.layer!.scene.origin[axis]!) as Vector;
        const bulk = firstView !== undefined ? undefined : bulkOf(packed, shift);
        const ahead = bulk === undefined ? depthAhead(packed, shift, position, forward) : undefined;
        this.home = (camera) => {
          if (bulk !== undefined) camera.frame(bulk.centre, bulk.radius);
          else if (ahead !== undefined) camera.turnAround(ahead);
        };
        if (!this.touched) this.reset();
      },
      progressed: (progress) => this.progressed(progress),
      settled: (isSettled) => {
        this.wasSettled ||= isSettled;
        this.updateStatistics({ state: isSettled ? "complete" : "streaming" });
        this.redraw();
      },
      damaged: (error) => this.host.failed(error, "scene"),
    };
  }

  private otherHost(shown: Shown): FeedHost {
    return {
      begin: (scene) => {
        shown.layer?.close();
        shown.layer = this.makeLayer(scene, shown.workers.known);
        return shown.layer;
      },
      rowsArrived: () => undefined,
      progressed: () => undefined,
      settled: () => undefined,
      damaged: (error) => this.host.failed(error, "other"),
    };
  }

  private makeLayer(
    scene: ConstructorParameters<typeof SplatLayer>[1],
    workers: ViewerWorkers | undefined,
  ): SplatLayer {
    const { gl } = this.renderer;
    const sorter = (rows: number): DepthSorter =>
      new DepthSorter(rows, workers, (message) => this.host.failed(new Error(message), "scene"));
    return new SplatLayer(gl, scene, DEFAULT_RANGES, this.budget, sorter, this.redraw);
  }

  private progressed(progress: FeedProgress): void {
    const { splats, totalSplats, bytes, totalBytes, predictedDb } = progress;
    this.updateStatistics({
      splats,
      totalSplats,
      bytes,
      ...(totalBytes !== undefined && { totalBytes }),
      ...(predictedDb !== undefined && { predictedDb }),
    });
  }

  private updateStatistics(changes: Partial<ViewerStatistics>): void {
    this.statistics = { ...this.statistics, ...changes };
    this.host.changed();
  }

  private close(which: "main" | "other"): void {
    this.runs[which]++;
    const shown = this[which];
    this[which] = undefined;
    shown?.abort.abort();
    shown?.layer?.close();
    shown?.workers.close();
  }

  /** Have `frame` called with the next frame of the browser, or after some time. */
  private schedule(after?: number): void {
    if (this.scheduled || this.abort.signal.aborted) return;
    this.scheduled = true;
    if (after === undefined) requestAnimationFrame(this.frame);
    else setTimeout(() => this.frame(performance.now()), after);
  }

  private readonly frame = (time: number): void => {
    this.scheduled = false;
    if (this.abort.signal.aborted || this.lost || this.isPresenting) return;
    const { controls, layers, pace } = this;
    this.passPose();
    const more = [this.main, this.other].map((shown) => shown?.feed.work(WORK_MILLISECONDS) ?? false).some(Boolean);
    if (!this.canDraw()) return;
    this.drawLevels(this.focal);
    pace.splats = layers.reduce((sum, layer) => sum + layer.rows, 0);
    if (!pace.isFree) {
      this.schedule(LOOK_MILLISECONDS);
      return;
    }
    const isUploaded = layers.map((layer) => layer.upload()).every(Boolean);
    // Slow pictures wait until all uploads are complete.
    if (!isUploaded && pace.isSlow) {
      pace.uploads();
      this.schedule();
      return;
    }
    // A pause between two movements is no slow picture.
    const passed = Math.min(time - this.lastFrame, 100);
    this.lastFrame = time;
    const moves = [controls.step(passed / 1000), this.stepMotion(passed / 1000)].some(Boolean);
    if (moves) this.lastChange = time;
    const isUrgent = moves || this.dirty;
    if (isUrgent || !this.isSharp) {
      // More rows usually follow soon, and a full picture would delay them; so would any picture that ends after they
      // arrive.
      const isSorting = layers.some((layer) => layer.isSorting);
      const isBusy = controls.active || isSorting || this.statistics.state === "streaming";
      const waits = !isUrgent || (!moves && !controls.active && pace.isSlow && (isSorting || this.isRestImminent()));
      if (isBusy && waits && performance.now() - this.lastChange < QUIET_MILLISECONDS) {
        this.schedule(LOOK_MILLISECONDS);
        return;
      }
      this.dirty = false;
      const scale = isUrgent && this.allowsLowResolution && this.pixelRatio === undefined ? pace.scale : 1;
      this.isSharp = scale === 1;
      this.isWhole = this.draw(scale);
      if (!isUploaded) this.dirty = true;
    }
    const isDrawn = !more && !moves && !this.dirty && this.isSharp;
    if (!isDrawn) this.schedule();
    else if (!pace.isIdle) this.schedule(LOOK_MILLISECONDS);
    this.updateStatistics({ upToDate: isDrawn && this.isWhole && pace.isIdle, pictureMilliseconds: pace.milliseconds });
    if (this.statistics.upToDate) for (const resolve of this.waiting.splice(0)) resolve();
  };

  /** Move the camera by the motion; return whether one goes on. */
  private stepMotion(seconds: number): boolean {
    const { motion, camera } = this;
    if (motion === undefined || camera === undefined || !this.visible) return false;
    this.touched = true;
    if (!motion(camera, seconds) && this.motion === motion) this.endMotion(false);
    return true;
  }

  /** Report the camera's rest some time after its last change. */
  private awaitRest(): void {
    clearTimeout(this.resting);
    this.resting = setTimeout(() => {
      if (this.motion !== undefined || this.controls.active) this.awaitRest();
      else this.host.rested();
    }, REST_MILLISECONDS);
  }

  /** Pass a changed pose to the feeds. */
  private passPose(): void {
    const { camera } = this;
    if (camera === undefined) return;
    const [width, height] = this.size(1);
    const { rotation, translation, focal } = camera.view(height, width);
    const seen = [rotation, translation, focal[1] / height].join();
    if (seen !== this.seen) {
      this.seen = seen;
      this.awaitRest();
    }
    const pose = { rotation, tanX: width / (2 * focal[0]), tanY: height / (2 * focal[1]) };
    const key = JSON.stringify([camera.position, pose, this.other?.layer?.scene.origin]);
    if (key === this.looked) return;
    this.looked = key;
    for (const shown of [this.main, this.other]) {
      const origin = shown?.layer?.scene.origin ?? this.origin;
      shown?.feed.setPose?.({
        ...pose,
        position: camera.position.map((x, axis) => x + this.origin[axis]! - origin[axis]!),
      });
    }
  }

  /** Focal length of the canvas, pixels; 1 before a scene is open. */
  private get focal(): number {
    const [width, height] = this.size(1);
    return this.camera?.view(height, width).focal[1] ?? 1;
  }

  /** Draw the level of a focal length, pixels, or the chosen one. */
  private drawLevels(focal: number): void {
    const [level, other] = [this.main, this.other].map((shown) => shown?.feed.drawLevel(focal, this.chosenLevel));
    if (level === this.statistics.level && other === this.otherLevel) return;
    this.otherLevel = other;
    this.dirty = true;
    if (level !== undefined) this.updateStatistics({ level });
  }

  /** Return the size of pictures at a resolution, pixels. */
  private size(scale: number): [number, number] {
    const { canvas } = this;
    const ratio = (this.pixelRatio ?? Math.min(devicePixelRatio, this.mostPixelRatio)) * scale;
    return [canvas.clientWidth, canvas.clientHeight].map((px) => Math.max(1, Math.round(px * ratio))) as [
      number,
      number,
    ];
  }

  /** Return whether the programs are built; otherwise retry on a timer. */
  private canDraw(): boolean {
    try {
      const { isReady } = this.renderer;
      if (!isReady) this.schedule(LOOK_MILLISECONDS);
      return isReady;
    } catch (error) {
      this.lost = true;
      this.close("main");
      this.updateStatistics({ state: "failed" });
      this.host.failed(error, "graphics");
      return false;
    }
  }

  /** Return whether the rest of the scene would arrive before the GPU finishes a picture. */
  private isRestImminent(): boolean {
    const { meter, pace, statistics } = this;
    if (statistics.state !== "streaming" || meter.since === undefined || this.wasSettled) return false;
    return millisecondsLeft({ ...statistics, bytes: meter.bytes }, performance.now() - meter.since) < pace.expected;
  }

  /** Draw the rows received; return whether they are all, in the requested view. */
  private draw(scale: number): boolean {
    const { camera, renderer, layers, pace, statistics } = this;
    const [width, height] = this.size(scale);
    // Resizing blocks until the GPU is idle, as it is before the first picture.
    renderer.resize(width, height);
    if (camera === undefined || layers.length === 0)
      return statistics.state === "failed" || statistics.state === "empty";
    // The picture of the scene that is loaded again stays until as much is there, or a person moves.
    if (statistics.state === "streaming" && layers[0]!.rows < this.keptRows && !this.hasMoved) return false;
    this.keptRows = 0;
    const start = performance.now();
    const arriving = statistics.state === "streaming" && this.fills && !this.wasSettled;
    const fill = arriving ? 1 - Math.min(statistics.splats / statistics.totalSplats, 1) : 0;
    const whole = renderer.draw({ ...camera.view(height, width), origin: this.origin }, layers, {
      ...this.picture,
      fill,
    });
    this.host.drawn();
    if (this.drawnRows > 0)
      pace.submitted(start, { scale, splats: layers.reduce((sum, layer) => sum + layer.drawnRows, 0) });
    this.updateStatistics({
      frames: statistics.frames + 1,
      drawnSplats: this.drawnRows,
      drawMilliseconds: performance.now() - start,
      sortMilliseconds: layers[0]!.sortMilliseconds,
    });
    return whole;
  }
}
