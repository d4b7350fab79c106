import type { LevelEntry } from "../container/root.js";
import { millisecondsLeft } from "./arrival_forecast.js";
import type { FetchOrder } from "./cogs_feed.js";
import { Controls, type ControlsHost } from "./controls.js";
import { Meter } from "./meter.js";
import type { Vector } from "./orbit.js";
import { PicturePace } from "./picture_pace.js";
import { plyOf } from "./ply_feed.js";
import { type EyeTarget, type PictureOptions, SplatRenderer, type View } from "./renderer.js";
import { SceneCamera, type SceneCameraHost } from "./scene_camera.js";
import type { DescriptionSource, FeedHost, FeedProgress, Prefix } from "./scene_feed.js";
import type { ShaderRows } from "./shader_rows.js";
import { type SceneSource, ShownScene } from "./shown_scene.js";
import type { LayerScene, SplatLayer } from "./splat_layer.js";
import { NO_STATISTICS, type ViewerPose, type ViewerStatistics } from "./viewer_handle.js";
import type { ViewerWorkers } from "./viewer_workers.js";

/** Longest work on compensation between two pictures, ms: a frame has 16. */
const WORK_MILLISECONDS = 5;
/** Time after the last change at which slow graphics draw at full resolution although more is to arrive, ms. */
const QUIET_MILLISECONDS = 300;
/** Interval at which the GPU is polled for the end of a picture, ms. */
const LOOK_MILLISECONDS = 4;

/** Callbacks of a scene view. */
export interface SceneViewHost
  extends Pick<ControlsHost, "leavesScrolling" | "left" | "tapped">,
    Pick<SceneCameraHost, "rested" | "motionEnded"> {
  /** Called when the first rows of a scene that has a description are there. */
  described(source: DescriptionSource): void;
  /** Called after each picture. */
  drawn(): void;
  /** Called when the statistics or the canvas have changed. */
  changed(): void;
  /** Called on an error of a scene, of the second scene or of WebGL. */
  failed(error: unknown, which: "scene" | "other" | "graphics"): void;
  /** Called when lost graphics are back. */
  restored(): void;
}

/** Ratio of the splats held and the budget, either way round, below which memory is allocated or freed. */
const TOO_FEW = 0.75;

/** Shows a scene, and optionally a second one, on a canvas: loads it, moves the camera, draws on demand. */
export class SceneView {
  readonly camera: SceneCamera;
  readonly controls: Controls;
  readonly meter = new Meter();
  statistics = NO_STATISTICS;
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
  private main: ShownScene | undefined;
  private other: ShownScene | undefined;
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
    this.camera = new SceneCamera({
      size: () => this.size(1),
      isHeld: () => this.controls.active,
      redraw: this.redraw,
      rested: () => host.rested(),
      motionEnded: (byPerson) => host.motionEnded(byPerson),
    });
    this.controls = new Controls(
      canvas,
      {
        camera: () => this.camera.orbit,
        touched: () => this.camera.endMotion(true),
        moved: () => {
          this.camera.wasMoved = this.hasMoved = true;
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

  /** Context that draws the scene. */
  get gl(): WebGL2RenderingContext {
    return this.renderer.gl;
  }

  /** Rows of the scene, and what to add to a point in the space of the poses for that of the rows' means. */
  get packed(): { readonly shaderRows: ShaderRows; readonly rows: number; readonly shift: Vector } | undefined {
    const layer = this.main?.layer;
    if (layer === undefined) return undefined;
    return { shaderRows: layer.shaderRows, rows: layer.rows, shift: this.shiftOf(layer) };
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
   * With many fewer the memory of the others is given back. The scene is loaded again with many more, and with many
   * fewer where it is fetched in view order; the canvas keeps its picture meanwhile. Without any the scene is closed.
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
      const isMuchLess = main.layer !== undefined && splats < TOO_FEW * main.layer.capacity;
      if (!isMuchLess || main.release(splats)) {
        this.applyBudget();
        return;
      }
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
    this.camera.leave();
    this.close("main");
    this.close("other");
    this.meter.reset();
    this.wasSettled = false;
    this.statistics = { ...NO_STATISTICS, state: "opening" };
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
    const { camera } = this;
    camera.endMotion(true);
    const before = camera.pose;
    this.isPresenting = true;
    return () => {
      this.isPresenting = false;
      if (before !== undefined) camera.orbit?.setPose(before);
      this.redraw();
    };
  }

  /** Draw the rows received for each eye of a head. */
  drawEyes(head: ViewerPose, eyes: readonly { readonly view: View; readonly target: EyeTarget }[]): void {
    const { renderer, main } = this;
    const { orbit, origin } = this.camera;
    if (orbit === undefined || main?.layer === undefined || this.lost) return;
    orbit.setPose(head);
    this.passPose();
    main.feed.work(WORK_MILLISECONDS);
    if (!this.canDraw()) return;
    this.drawLevels(head.fy);
    main.layer.upload();
    const options = { ...this.picture, fill: 0 };
    for (const { view, target } of eyes) renderer.draw({ ...view, origin }, [main.layer], options, target);
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
    this.camera.close();
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
    const isMain = which === "main";
    const run = ++this.runs[which];
    const ply = await plyOf(source);
    if (run !== this.runs[which]) return;
    const { budget, order, workers } = this;
    const meter = isMain ? this.meter : new Meter();
    const shown = new ShownScene(source, ply, { meter, workers, budget, order });
    this[which] = shown;
    try {
      await shown.run(isMain ? this.mainHost(shown) : this.otherHost(shown));
      if (isMain) this.updateStatistics({ state: "complete" });
      this.redraw();
    } catch (error) {
      if (shown.isClosed) return;
      if (isMain) this.updateStatistics({ state: "failed" });
      else this.close("other");
      this.host.failed(error, isMain ? "scene" : "other");
      this.redraw();
    }
  }

  private mainHost(shown: ShownScene): FeedHost {
    return {
      begin: (scene, info) => {
        this.axes = info.axes;
        this.degree = scene.shDegree;
        this.levels = info.levels;
        this.camera.enter(info, this.keptRows > 0);
        this.updateStatistics({ state: "streaming", totalSplats: scene.splats });
        return this.makeLayer(shown, scene);
      },
      rowsArrived: (packed, first) => {
        const { descriptionSource } = shown.feed;
        if (first && descriptionSource !== undefined) this.host.described(descriptionSource);
        const { firstView } = shown.feed;
        // Without a first view with a target, the first splats show where to stand or what to turn around.
        if (first && firstView?.target === undefined)
          this.camera.frameRows(packed, this.shiftOf(shown.layer!), firstView !== undefined);
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

  private otherHost(shown: ShownScene): FeedHost {
    return {
      begin: (scene) => this.makeLayer(shown, scene),
      rowsArrived: () => undefined,
      progressed: () => undefined,
      settled: () => undefined,
      damaged: (error) => this.host.failed(error, "other"),
    };
  }

  private makeLayer(shown: ShownScene, scene: LayerScene): SplatLayer {
    const failed = (error: Error): void => this.host.failed(error, "scene");
    return shown.makeLayer(this.renderer.gl, scene, this.budget, this.redraw, failed);
  }

  /** Return the vector from means of a layer's rows to points in the space of the poses. */
  private shiftOf({ scene }: SplatLayer): Vector {
    return this.camera.origin.map((value, axis) => value - scene.origin[axis]!) as Vector;
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
    shown?.close();
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
    this.drawLevels(this.camera.focal);
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
    const moves = [controls.step(passed / 1000), this.camera.step(passed / 1000)].some(Boolean);
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

  /** Pass a changed pose to the feeds. */
  private passPose(): void {
    const { orbit, origin: zero } = this.camera;
    if (orbit === undefined) return;
    this.camera.watchRest();
    const [width, height] = this.size(1);
    const { rotation, focal } = orbit.view(height, width);
    const pose = { rotation, tanX: width / (2 * focal[0]), tanY: height / (2 * focal[1]) };
    const key = JSON.stringify([orbit.position, pose, this.other?.layer?.scene.origin]);
    if (key === this.looked) return;
    this.looked = key;
    for (const shown of [this.main, this.other]) {
      const origin = shown?.layer?.scene.origin ?? zero;
      shown?.feed.setPose?.({ ...pose, position: orbit.position.map((x, axis) => x + zero[axis]! - origin[axis]!) });
    }
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
    const { renderer, layers, pace, statistics } = this;
    const { orbit, origin } = this.camera;
    const [width, height] = this.size(scale);
    // Resizing blocks until the GPU is idle, as it is before the first picture.
    renderer.resize(width, height);
    if (orbit === undefined || layers.length === 0)
      return statistics.state === "failed" || statistics.state === "empty";
    // The picture of the scene that is loaded again stays until as much is there, or a person moves.
    if (statistics.state === "streaming" && layers[0]!.rows < this.keptRows && !this.hasMoved) return false;
    this.keptRows = 0;
    const start = performance.now();
    const arriving = statistics.state === "streaming" && this.fills && !this.wasSettled;
    const fill = arriving ? 1 - Math.min(statistics.splats / statistics.totalSplats, 1) : 0;
    const whole = renderer.draw({ ...orbit.view(height, width), origin }, layers, { ...this.picture, fill });
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
