import type { Description } from "../container/description.js";
import { folders } from "../loader/folders.js";
import { StreamedScene } from "../loader/streamed_scene.js";
import { About } from "./about.js";
import { graphicsOf } from "./device_budget.js";
import { Divide } from "./divide.js";
import { MARKUP } from "./markup.js";
import { formatBytes, formatShare, parseColour } from "./numbers.js";
import { RADIANS_PER_PIXEL } from "./orbit.js";
import { PageBudget } from "./page_budget.js";
import type { DescriptionSource } from "./scene_feed.js";
import { absoluteAddress, fileName } from "./scene_name.js";
import { SceneView } from "./scene_view.js";
import { describeError, GRAPHICS_LOST, type Sentence, wheelHint } from "./sentences.js";
import type { SceneSource } from "./shown_scene.js";
import { STYLE } from "./style.js";
import { parsePoint, parseUp, parseView } from "./view_text.js";
import type { Extras } from "./viewer_extras.js";
import { NO_STATISTICS, type ViewerHandle, type ViewerPose, type ViewerStatistics } from "./viewer_handle.js";
import { type ViewerWorkers, workersBeside } from "./viewer_workers.js";

/** Time for which the statistics stay visible after the scene is complete, ms. */
const QUIET_AFTER = 2500;
/** Time for which a hint is shown, ms. */
const HINT_MILLISECONDS = 1800;
/** Rotation by itself, degrees per second. */
const ROTATION = 12;
/** Margin around the screen within which an element keeps its splats. */
const NEAR = "50%";
/** Share of the window's width and height that an element covers which has the page's gestures. */
const FILLS_WINDOW = 0.95;

/** Program of the extras, loaded on first use. */
export interface ExtrasModule {
  readonly Extras: typeof Extras;
}

/** Base class of elements; a server that renders pages imports this module too, and has none. */
const PageElement = globalThis.HTMLElement ?? (class {} as typeof HTMLElement);

/**
 * `<cogsplat-viewer src="scene.cogs">`: an interactive view of a scene; a page may have several.
 *
 * | attribute | meaning |
 * |---|---|
 * | `src` | URL of a `.cogs` file or a PLY of splats; setting it shows another scene |
 * | `against` | URL of a second scene to compare with, left of a movable line |
 * | `label` | name of the scene, also for assistive technology; by default the file's name |
 * | `against-label` | name of the second scene; by default the file's name |
 * | `background` | CSS colour behind the splats; black by default |
 * | `sh-degree` | highest SH degree drawn, 0 to 3 |
 * | `level` | level drawn in a scene with levels, 0 the coarsest, or a number between two; by default by the picture's size |
 * | `splat-budget` | splats in memory at most, in place of a share of the budget that the viewers of a page divide |
 * | `order` | fetch order: `view` or `file`; by default `view` for files cut into cells |
 * | `pixel-ratio` | device pixels per CSS pixel at most; 2 by default |
 * | `resolution` | `full` draws moving and arriving pictures at full resolution on slow graphics too |
 * | `fill-holes` | `off` leaves holes between splats while the scene arrives |
 * | `controls` | `none` hides the buttons |
 * | `view` | first pose, `x,y,z,tx,ty,tz,fov`: position, target, vertical field of view in degrees, and optionally the roll |
 * | `up` | direction against gravity, `x,y,z` or an axis such as `-y`; by default that of the scene |
 * | `target` | point that turning goes around, `x,y,z` |
 * | `gestures` | `all`: the wheel and one finger move the camera; `page`: they scroll the page; by default `all` where the element fills the window |
 * | `lazy` | nothing is fetched until the element is on the screen; `click`: until its button is pressed, but for the poster |
 * | `poster` | URL of a picture shown until the first picture of the scene; with `lazy="click"` by default that of the file |
 * | `orbit` | `free`: turning may go anywhere; by default it stays off the poles, above the ground, and at most 10° below the first view |
 * | `auto-rotate` | turns until a touch, in degrees per second; 12 by default, none where the system asks for reduced motion |
 *
 * It dispatches `cogsplat-change` when `statistics` change, and `cogsplat-view` when the camera has come to rest in
 * another pose. Removing it from the page ends its workers and frees its
 * memory.
 */
export class CogsplatViewer extends PageElement implements ViewerHandle {
  static readonly observedAttributes = [
    "src",
    "against",
    "label",
    "against-label",
    "background",
    "sh-degree",
    "level",
    "splat-budget",
    "order",
    "pixel-ratio",
    "resolution",
    "fill-holes",
    "controls",
    "view",
    "up",
    "target",
    "gestures",
    "poster",
    "auto-rotate",
    "orbit",
  ];
  /** Workers of all viewers; by default the programs next to this one. */
  static workers: ViewerWorkers | undefined = workersBeside(import.meta.url);

  /** Splats in memory at most, of all viewers of the page; `total` may be set. */
  static readonly budget = new PageBudget();
  /** Loads the program of the extras on first use. */
  static loadExtras: () => Promise<ExtrasModule> = () => import("./viewer_extras.js");

  private readonly shadow = this.attachShadow({ mode: "open" });
  private scene: SceneView | undefined;
  private divide: Divide | undefined;
  private abort: AbortController | undefined;
  private source: SceneSource | undefined;
  private otherSource: SceneSource | undefined;
  private error: Sentence | undefined;
  private pose: ViewerPose | undefined;
  private fills = true;
  private quiet: ReturnType<typeof setTimeout> | undefined;
  private hint: ReturnType<typeof setTimeout> | undefined;
  private extras: Extras | undefined;
  private about: About | undefined;
  private isTurning = false;
  /** Splats of the scene; Infinity before they are known, 0 without a scene. */
  private wanted = 0;
  /** Whether the element is on the screen, or less than half a screen away. */
  private isNear = true;
  /** Rotation to begin with the first picture, degrees per second. */
  private rotation: number | undefined;

  get statistics(): ViewerStatistics {
    const statistics = this.scene?.statistics ?? { ...NO_STATISTICS, ...(this.error && { state: "failed" as const }) };
    return this.error === undefined ? statistics : { ...statistics, error: this.error.detail };
  }

  get view(): ViewerPose | undefined {
    return this.scene?.camera.pose ?? this.pose;
  }

  /** Text of the camera's pose, as `cogsplat --view` takes it; undefined before a scene is open. */
  get viewText(): string | undefined {
    return this.scene?.camera.text;
  }

  set view(view: ViewerPose | undefined) {
    this.pose = view;
    if (this.scene) this.scene.camera.pose = view;
  }

  get fillHoles(): boolean {
    return this.fills;
  }

  set fillHoles(fills: boolean) {
    this.fills = fills;
    if (this.scene) this.scene.fillHoles = fills;
  }

  /** Show a scene from a URL or a file. */
  async load(source: SceneSource): Promise<void> {
    this.source = source;
    this.otherSource = undefined;
    this.showMessage(undefined);
    this.forgetDescription();
    this.nameScenes();
    this.root?.classList.remove("shown");
    if (this.scene) this.askFor(Infinity);
    await this.scene?.load(source);
  }

  /** Compare with a second scene, left of a movable line; undefined ends the comparison. */
  async compare(source: SceneSource | undefined): Promise<void> {
    this.otherSource = source;
    this.nameScenes();
    await this.scene?.compare(source);
    this.nameScenes();
  }

  connectedCallback(): void {
    const { shadow } = this;
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(STYLE);
    shadow.adoptedStyleSheets = [sheet];
    shadow.innerHTML = MARKUP;
    this.abort = new AbortController();
    this.apply("poster", this.getAttribute("poster"));
    this.nameScenes();
    if (this.hasAttribute("lazy") && this.source === undefined) this.wait();
    else this.start();
  }

  disconnectedCallback(): void {
    this.abort?.abort();
    clearTimeout(this.quiet);
    clearTimeout(this.hint);
    CogsplatViewer.budget.leave(this);
    this.forgetDescription();
    this.scene?.dispose();
    this.scene = this.extras = undefined;
    this.shadow.replaceChildren();
  }

  /** Start when the element comes onto the screen or, with `lazy="click"`, when its button is pressed. */
  private wait(): void {
    const { signal } = this.abort!;
    const begin = (): void => {
      root.classList.remove("waiting");
      button.hidden = true;
      this.start();
    };
    const root = this.root!;
    const button = this.find("#start");
    root.classList.add("waiting");
    if (this.getAttribute("lazy") === "click") {
      button.hidden = false;
      const options = { signal, once: true };
      button.addEventListener("click", () => [begin(), this.find("canvas").focus()], options);
      const src = this.getAttribute("src");
      if (src !== null && !this.hasAttribute("poster")) void this.showFilePoster(src, signal);
    } else this.watch(signal, (isVisible, observer) => isVisible && [observer.disconnect(), begin()]);
  }

  /** Show the poster that the file holds, if any; the rest of the file is not fetched. */
  private async showFilePoster(src: string, signal: AbortSignal): Promise<void> {
    try {
      const scene = await StreamedScene.open(absoluteAddress(src, document.baseURI), { signal, folders });
      const picture = await scene.picture("poster", signal);
      if (picture === undefined) return;
      const bitmap = await createImageBitmap(picture);
      const canvas = document.createElement("canvas");
      canvas.className = "poster";
      canvas.id = "filePoster";
      [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
      // Not an image element, whose blob a page's policy may refuse.
      canvas.getContext("bitmaprenderer")!.transferFromImageBitmap(bitmap);
      this.find("#loading").prepend(canvas);
    } catch {
      // Without a poster the element waits all the same; pressing its button says what is wrong with the scene.
    }
  }

  /** Call a function when the element enters or leaves the screen. */
  private watch(
    signal: AbortSignal,
    seen: (isVisible: boolean, observer: IntersectionObserver) => void,
    rootMargin = "0px",
  ): void {
    const look = (entries: IntersectionObserverEntry[]): void => seen(entries.at(-1)!.isIntersecting, observer);
    const observer = new IntersectionObserver(look, { rootMargin });
    observer.observe(this);
    signal.addEventListener("abort", () => observer.disconnect());
  }

  /** Make the scene view, and load the scene that the attributes name. */
  private start(): void {
    const { signal } = this.abort!;
    const canvas = this.find<HTMLCanvasElement>("canvas");
    try {
      this.scene = new SceneView(
        canvas,
        {
          changed: () => this.updateProgress(),
          failed: (error, which) => this.onFailed(error, which),
          restored: () => this.showMessage(undefined),
          rested: () => {
            this.dispatchEvent(new Event("cogsplat-view"));
            this.extras?.rested();
          },
          described: (source) => void this.describe(source),
          drawn: () => this.extras?.drawn(),
          motionEnded: () => {
            this.isTurning = false;
            this.extras?.motionEnded();
          },
          leavesScrolling: () => this.leavesScrolling,
          left: (input) => this.showHint(input === "finger" ? "Two fingers turn the scene" : wheelHint()),
          tapped: (x, y, isDouble) => {
            if (isDouble || this.extras !== undefined) void this.withExtras((extras) => extras.tapped(x, y, isDouble));
          },
        },
        CogsplatViewer.workers,
      );
    } catch (error) {
      this.onFailed(error, "graphics");
      return;
    }
    const { scene } = this;
    CogsplatViewer.budget.adapt(graphicsOf(scene.gl));
    scene.camera.pose = this.pose;
    scene.fillHoles = this.fills;
    this.divide = new Divide(this.find("#divide"), (share) => scene.show({ divide: share }), signal);
    this.listen(signal);
    for (const name of CogsplatViewer.observedAttributes) {
      if (name !== "src" && name !== "against") this.apply(name, this.getAttribute(name));
    }
    if (this.source !== undefined) void this.load(this.source);
    else this.apply("src", this.getAttribute("src"));
    this.updateProgress();
  }

  attributeChangedCallback(name: string, before: string | null, value: string | null): void {
    if ((this.scene !== undefined || name === "poster") && before !== value && this.root !== null) {
      this.apply(name, value);
    }
  }

  private get root(): HTMLElement | null {
    return this.shadow.querySelector("#root");
  }

  private find<E extends HTMLElement>(selector: string): E {
    return this.shadow.querySelector<E>(selector)!;
  }

  private apply(name: string, value: string | null): void {
    const scene = this.scene!;
    if (name === "poster") {
      const image = this.find<HTMLImageElement>("#poster");
      image.hidden = value === null;
      if (value !== null) image.src = absoluteAddress(value, document.baseURI);
    } else if (name === "view" || name === "up" || name === "target") this.setStart(name, value);
    else if (name === "gestures") this.chooseGestures();
    else if (name === "orbit") scene.camera.orbitsFreely = value === "free";
    else if (name === "auto-rotate") {
      const degrees = value === null || value.trim() === "" ? ROTATION : Number(value);
      const isCalm = matchMedia("(prefers-reduced-motion: reduce)").matches;
      this.rotation = value === null || isCalm || !Number.isFinite(degrees) ? undefined : degrees;
      if (scene.isShown) this.rotate(this.rotation);
    } else if (name === "src" && value !== null) {
      const against = this.getAttribute("against");
      void this.load(absoluteAddress(value, document.baseURI));
      if (against !== null) this.apply("against", against);
    } else if (name === "against") {
      void this.compare(value === null ? undefined : absoluteAddress(value, document.baseURI));
    } else if (name === "background") {
      const colour = parseColour(value ?? "black");
      if (colour === undefined) return;
      scene.show({ background: colour });
      // Pixels without splats are as transparent as the background.
      this.style.background = value ?? "";
    } else if (name === "sh-degree") scene.show({ degree: value === null ? 3 : Number(value) });
    else if (name === "level") {
      scene.level = value === null || !Number.isFinite(Number(value)) ? undefined : Number(value);
    } else if (name === "splat-budget") {
      scene.limit(value === null ? Infinity : Number(value));
      this.askFor(this.wanted);
    } else if (name === "order") scene.order = value === "view" || value === "file" ? value : undefined;
    else if (name === "pixel-ratio") scene.mostPixelRatio = value === null ? 2 : Number(value);
    else if (name === "resolution") scene.allowsLowResolution = value !== "full";
    else if (name === "fill-holes") this.fillHoles = value !== "off";
    else if (name === "controls") this.find("#tools").hidden = value === "none";
    else if (name === "label" || name === "against-label") this.nameScenes();
  }

  /** Ask for splats of the page's budget. */
  private askFor(splats: number): void {
    this.wanted = splats;
    const given = this.getAttribute("splat-budget");
    const wish = {
      splats: Math.min(splats, given === null ? Infinity : Number(given)),
      size: this.isNear ? this.clientWidth * this.clientHeight : 0,
      isChosen: given !== null,
    };
    CogsplatViewer.budget.ask(this, wish, (share) => this.scene?.share(share));
  }

  private listen(signal: AbortSignal): void {
    const click = (id: string, act: () => void): void => this.find(`#${id}`).addEventListener("click", act, { signal });
    click("reset", () => this.scene!.camera.reset());
    const toggleStrip = (): void => void this.withExtras((extras) => extras.toggleStrip());
    click("film", toggleStrip);
    const togglePanel = (): void => void this.withExtras((extras) => extras.togglePanel());
    click("settings", togglePanel);
    click("full", () => void this.toggleFullScreen());
    click("headset", () => void this.withExtras((extras) => extras.toggleHeadset()));
    void this.offerHeadset();
    click("again", () => void (this.source !== undefined && this.load(this.source)));
    this.watch(signal, (isVisible) => {
      this.scene!.camera.isVisible = isVisible;
    });
    const sighted = (isNear: boolean): void => {
      this.isNear = isNear;
      this.askFor(this.wanted);
    };
    this.watch(signal, sighted, NEAR);
    const resized = new ResizeObserver(() => {
      this.chooseGestures();
      this.askFor(this.wanted);
    });
    resized.observe(this);
    signal.addEventListener("abort", () => resized.disconnect());
    window.addEventListener("resize", () => this.chooseGestures(), { signal });
    const file = this.find<HTMLInputElement>("#file");
    file.addEventListener(
      "change",
      () => {
        const chosen = file.files?.[0];
        if (chosen) void this.compare(chosen);
        file.value = "";
      },
      { signal },
    );
    this.addEventListener(
      "keydown",
      (event) => {
        // Keys typed into a field are no commands.
        const inField = event
          .composedPath()
          .some((target) => target instanceof HTMLInputElement || target instanceof HTMLSelectElement);
        if (event.ctrlKey || event.metaKey || event.altKey || (inField && event.code !== "Escape")) return;
        const command = {
          KeyR: () => this.scene!.camera.reset(),
          KeyF: () => void this.toggleFullScreen(),
          KeyC: () => void this.copyView(),
          KeyG: togglePanel,
          KeyM: () => void this.withExtras((extras) => extras.toggleMeasure()),
          KeyT: toggleStrip,
          Escape: () => this.closePanels(),
        }[event.code];
        if (command === undefined) return;
        event.preventDefault();
        command();
      },
      { signal },
    );
    this.addEventListener(
      "dragover",
      (event) => {
        event.preventDefault();
        this.root!.classList.add("over");
      },
      { signal },
    );
    this.addEventListener("dragleave", () => this.root!.classList.remove("over"), { signal });
    this.addEventListener(
      "drop",
      (event) => {
        event.preventDefault();
        this.root!.classList.remove("over");
        const dropped = event.dataTransfer?.files[0];
        if (dropped) void (event.shiftKey && this.source !== undefined ? this.compare(dropped) : this.load(dropped));
      },
      { signal },
    );
  }

  /** Show the button of headsets where the browser has one. */
  private async offerHeadset(): Promise<void> {
    const { xr } = navigator as { readonly xr?: { isSessionSupported(mode: string): Promise<boolean> } };
    // A page may forbid headsets to its frames.
    const isSupported = await xr?.isSessionSupported("immersive-vr").catch(() => false);
    if (isSupported && this.root !== null) this.find("#headset").hidden = false;
  }

  /** Whether the wheel and one finger scroll the page: the element does not fill the window, or the page is a frame. */
  private get leavesScrolling(): boolean {
    return this.root?.classList.contains("embedded") ?? false;
  }

  /** Set where the camera starts, by an attribute. */
  private setStart(name: "view" | "up" | "target", value: string | null): void {
    try {
      const parse = { view: parseView, up: parseUp, target: parsePoint }[name];
      this.scene!.camera.startFrom({ [name]: value === null ? undefined : parse(value) });
    } catch (error) {
      if (!(error instanceof SyntaxError)) throw error;
      this.showMessage({ title: `The attribute ${name} cannot be used`, detail: error.message }, false);
    }
  }

  /** Copy the text of the camera's pose; where the browser allows none, show it. */
  private async copyView(): Promise<void> {
    const text = this.viewText;
    if (text === undefined) return;
    // Lines break between numbers.
    const shown = text.replaceAll(",", ", ");
    try {
      await navigator.clipboard.writeText(text);
      this.showHint(`Copied: ${shown}`);
    } catch {
      this.showHint(`The view: ${shown}`, 10 * HINT_MILLISECONDS);
    }
  }

  private chooseGestures(): void {
    const asked = this.getAttribute("gestures");
    const { width, height } = this.getBoundingClientRect();
    const fills = width >= FILLS_WINDOW * innerWidth && height >= FILLS_WINDOW * innerHeight;
    const isWhole = this.matches(":fullscreen") || (fills && window === window.top);
    this.root?.classList.toggle("embedded", asked === "page" || (asked !== "all" && !isWhole));
  }

  /** Turn about the target by itself, degrees per second, until a person moves. */
  private rotate(degrees: number | undefined): void {
    const { scene } = this;
    if (scene === undefined) return;
    if (degrees === undefined) {
      scene.camera.endMotion(true);
      return;
    }
    scene.camera.move((camera, seconds) => {
      camera.turn((degrees * seconds * Math.PI) / 180 / RADIANS_PER_PIXEL, 0);
      return true;
    });
    this.isTurning = true;
  }

  /** Load the extras and call a function with them; show a message if they cannot be loaded. */
  private async withExtras(act: (extras: Extras) => void | Promise<void>): Promise<void> {
    const { scene } = this;
    try {
      const { Extras } = await CogsplatViewer.loadExtras();
      if (scene === undefined || this.scene !== scene) return;
      this.extras ??= new Extras({
        host: this,
        root: this.root!,
        canvas: this.find("canvas"),
        overlay: this.find("#overlay"),
        foot: this.find(".foot"),
        tools: this.find("#tools"),
        scene,
        hint: (text) => this.showHint(text),
        closePanels: () => this.closePanels(),
        description: () => this.about?.description,
        describe: (description) => this.showDescription(description, false),
        reload: () => void (this.source !== undefined && this.load(this.source)),
        chooseOther: () => this.find("#file").click(),
        rotate: (turns) => this.rotate(turns ? ROTATION : undefined),
        isTurning: () => this.isTurning,
        copyView: () => void this.copyView(),
      });
    } catch (error) {
      this.showHint(`A part of the viewer cannot be loaded: ${String(error)}`, 6 * HINT_MILLISECONDS);
      return;
    }
    await act(this.extras);
  }

  /** Show the description of a scene; the program of what its texts do not need is loaded. */
  private async describe(source: DescriptionSource): Promise<void> {
    try {
      const description = await source.description();
      if (description === undefined) return;
      this.forgetDescription();
      this.showDescription(description, this.hasAttribute("background"));
      const { annotations, path, sky } = description;
      if (annotations.length > 0 || path !== undefined || sky !== undefined)
        await this.withExtras((extras) => extras.describe(source));
    } catch (error) {
      if (!source.signal.aborted) this.showHint(`The description of the scene cannot be shown: ${String(error)}`);
    }
  }

  /** Show title, texts, credits and lists of a description, and its background unless the page has one. */
  private showDescription(description: Description, hasBackground: boolean): void {
    const { background } = description;
    this.about?.remove();
    this.about = new About(
      {
        overlay: this.find("#overlay"),
        foot: this.find(".foot"),
        closePanels: () => this.closePanels(),
        flyTo: (view) => void this.withExtras((extras) => extras.flyTo(view)),
        showAnnotation: (number) => void this.withExtras((extras) => extras.showAnnotation(number)),
      },
      description,
    );
    if (background === undefined || hasBackground) return;
    const [r, g, b] = background as [number, number, number];
    this.scene!.show({ background: [r, g, b, 1] });
  }

  private forgetDescription(): void {
    this.about?.remove();
    this.about = undefined;
    this.extras?.clear();
  }

  /** Close what lies over the picture. */
  private closePanels(): void {
    this.about?.close();
    this.extras?.closePanels();
  }

  /** Show a short text over the picture. */
  private showHint(text: string, milliseconds = HINT_MILLISECONDS): void {
    const toast = this.find("#toast");
    toast.textContent = text;
    toast.classList.add("shown");
    clearTimeout(this.hint);
    this.hint = setTimeout(() => toast.classList.remove("shown"), milliseconds);
  }

  private async toggleFullScreen(): Promise<void> {
    if (this.matches(":fullscreen")) await document.exitFullscreen();
    else await this.requestFullscreen();
  }

  /** Update the progress of the scene. */
  private updateProgress(): void {
    const { scene } = this;
    const root = this.root;
    if (scene === undefined || root === null) return;
    const { statistics } = scene;
    const { state, splats, totalSplats, bytes, totalBytes, predictedDb } = statistics;
    if (totalSplats > 0) this.askFor(totalSplats);
    root.classList.toggle("empty", state === "empty");
    root.classList.toggle("failed", state === "failed" && !scene.isShown);
    if (scene.isShown && !root.classList.contains("shown")) {
      root.classList.add("shown");
      if (this.rotation !== undefined) this.rotate(this.rotation);
    }
    this.find("#hint").textContent =
      state === "empty"
        ? "Drop a .cogs file or a PLY of splats here."
        : state === "opening"
          ? "Opening …"
          : `Loading … ${formatBytes(bytes)}`;
    const share = totalBytes === undefined ? splats / Math.max(totalSplats, 1) : bytes / totalBytes;
    const done = state === "complete";
    this.find("#line > div").style.transform = `scaleX(${done ? 1 : Math.min(share, 1)})`;
    this.find("#line").setAttribute("aria-valuenow", String(Math.round(100 * (done ? 1 : share))));
    const texts = [
      totalBytes !== undefined && !done
        ? formatShare(Math.min(bytes, totalBytes), totalBytes)
        : formatBytes(totalBytes ?? bytes),
      `${splats.toLocaleString()} splats`,
      ...(predictedDb === undefined ? [] : [`${predictedDb.toFixed(1)} dB predicted`]),
    ];
    const progress = this.find("#progress");
    const text = totalSplats > 0 ? texts.join(" · ") : "Opening …";
    if (progress.textContent !== text) progress.textContent = text;
    progress.title =
      predictedDb === undefined
        ? ""
        : "PSNR against the source: the mean of the encoder's test views, none of them close up";
    this.extras?.changed(state !== this.lastState && state === "streaming");
    if (state !== this.lastState) this.onState(state);
    this.dispatchEvent(new Event("cogsplat-change"));
  }

  private lastState: ViewerStatistics["state"] | undefined;

  private onState(state: ViewerStatistics["state"]): void {
    this.lastState = state;
    clearTimeout(this.quiet);
    this.root!.classList.remove("quiet");
    if (state === "complete") {
      this.quiet = setTimeout(() => this.root?.classList.add("quiet"), QUIET_AFTER);
    }
  }

  private nameScenes(): void {
    const { source, otherSource } = this;
    if (this.root === null) return;
    const name = this.getAttribute("label") ?? fileName(source);
    this.find("canvas").setAttribute("aria-label", name === "" ? "Splat scene" : `Splat scene ${name}`);
    const compares = otherSource !== undefined && (this.scene?.compares ?? false);
    this.find("#sceneName").textContent = name;
    const given = otherSource instanceof File ? null : this.getAttribute("against-label");
    this.find("#otherName").textContent = given ?? fileName(otherSource);
    for (const id of ["#sceneName", "#otherName"]) this.find(id).hidden = !compares;
    if (this.divide) this.divide.shown = compares;
  }

  private onFailed(error: unknown, which: "scene" | "other" | "graphics"): void {
    if (which === "graphics" && error === undefined) {
      this.showMessage(GRAPHICS_LOST, false);
      return;
    }
    const given = which === "other" ? this.otherSource : this.source;
    const sentence = describeError(error, this.scene?.isShown ?? false, typeof given === "string" ? given : undefined);
    if (which === "other") {
      this.otherSource = undefined;
      this.nameScenes();
      this.showMessage({ ...sentence, title: `Nothing to compare with: ${sentence.title.toLowerCase()}` }, false);
    } else this.showMessage(sentence);
    this.updateProgress();
  }

  /** Show a message, or hide it with undefined; `again` offers to load the scene once more. */
  private showMessage(sentence: Sentence | undefined, again = this.source !== undefined): void {
    this.error = sentence;
    const message = this.shadow.querySelector<HTMLElement>("#message");
    if (message === null) return;
    message.hidden = sentence === undefined;
    if (sentence === undefined) return;
    this.root!.classList.add("failed");
    message.querySelector("h2")!.textContent = sentence.title;
    message.querySelector("p")!.textContent = sentence.detail;
    this.find("#again").hidden = !again;
  }
}

/** Define `<cogsplat-viewer>`, unless another copy of this program has defined it. */
export function defineViewer(): void {
  if (customElements.get("cogsplat-viewer") === undefined) customElements.define("cogsplat-viewer", CogsplatViewer);
}

declare global {
  interface HTMLElementTagNameMap {
    "cogsplat-viewer": CogsplatViewer;
  }
}
