import { Divide } from "./divide.js";
import { FilmStrip } from "./film_strip.js";
import { MARKUP } from "./markup.js";
import { colourOf, sizeText } from "./numbers.js";
import { Panel } from "./panel.js";
import { type SceneSource, SceneView } from "./scene_view.js";
import { describe, type Sentence } from "./sentences.js";
import { STYLE } from "./style.js";
import type { ViewerHandle, ViewerPose, ViewerStatistics } from "./viewer_handle.js";
import { type ViewerWorkers, workersBeside } from "./viewer_workers.js";

/** Splats that are drawn at most where fingers are the pointer: phones have less memory and less power. */
const BUDGET_OF_PHONES = 1_500_000;
/** How long the numbers stay when a scene is whole, ms. */
const QUIET_AFTER = 2500;

const NOTHING: ViewerStatistics = {
  state: "empty",
  splats: 0,
  totalSplats: 0,
  bytes: 0,
  frames: 0,
  drawMilliseconds: 0,
  pictureMilliseconds: 0,
  sortMilliseconds: 0,
  upToDate: false,
};

/**
 * `<cogsplat-viewer src="scene.cogs">`: a scene to look at, on any page, any number of times.
 *
 * | attribute | meaning |
 * |---|---|
 * | `src` | URL of a `.cogs` file or of a PLY of splats; set it anew to show another scene |
 * | `against` | URL of a second one to compare with, left of a line that can be moved |
 * | `label` | what the scene is called, by assistive technology as well; the file's name by default |
 * | `against-label` | what the second one is called; its file's name by default |
 * | `background` | a CSS colour behind the splats; black by default |
 * | `sh-degree` | highest SH degree that is drawn, 0 to 3 |
 * | `level` | of a scene with levels, the one that is drawn, 0 the coarsest, or a place between two; that of the picture's size by default |
 * | `splat-budget` | most splats in memory; 1,500,000 by default where fingers are the pointer |
 * | `order` | `view`: what is looked at is fetched first and, in a scene larger than its budget, takes the place of other things; `file`: the first chunks of the file; by default `view` where the file was cut into cells |
 * | `pixel-ratio` | most device pixels for a CSS pixel; 2 by default |
 * | `resolution` | `full` draws all pixels of moving and growing pictures too, where graphics are slow |
 * | `fill-holes` | `off` shows holes between splats while the scene arrives |
 * | `controls` | `none` shows no buttons |
 *
 * It fires `cogsplat-change` when `statistics` change. Leaving the page ends its workers and gives all memory back.
 */
export class CogsplatViewer extends HTMLElement implements ViewerHandle {
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
  ];
  /** How workers are started: from the programs beside this one, by default. */
  static workers: ViewerWorkers | undefined = workersBeside(import.meta.url);

  private readonly shadow = this.attachShadow({ mode: "open" });
  private scene: SceneView | undefined;
  private panel: Panel | undefined;
  private strip: FilmStrip | undefined;
  private divide: Divide | undefined;
  private abort: AbortController | undefined;
  private source: SceneSource | undefined;
  private otherSource: SceneSource | undefined;
  private error: Sentence | undefined;
  private pose: ViewerPose | undefined;
  private fills = true;
  private quiet: ReturnType<typeof setTimeout> | undefined;

  get statistics(): ViewerStatistics {
    const statistics = this.scene?.statistics ?? { ...NOTHING, ...(this.error && { state: "failed" as const }) };
    return this.error === undefined ? statistics : { ...statistics, error: this.error.detail };
  }

  get view(): ViewerPose | undefined {
    return this.pose;
  }

  set view(view: ViewerPose | undefined) {
    this.pose = view;
    if (this.scene) this.scene.view = view;
  }

  get fillHoles(): boolean {
    return this.fills;
  }

  set fillHoles(fills: boolean) {
    this.fills = fills;
    if (this.scene) this.scene.fillHoles = fills;
  }

  /** Show a scene: a URL, or a file. */
  async load(source: SceneSource): Promise<void> {
    this.source = source;
    this.otherSource = undefined;
    this.say(undefined);
    this.strip?.close();
    this.nameScenes();
    this.root?.classList.remove("shown");
    await this.scene?.load(source);
  }

  /** Show a second scene left of a line that can be moved; undefined ends that. */
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
    const { signal } = this.abort;
    const canvas = this.find<HTMLCanvasElement>("canvas");
    try {
      this.scene = new SceneView(
        canvas,
        {
          changed: () => this.changed(),
          failed: (error, which) => this.failed(error, which),
          restored: () => this.say(undefined),
        },
        CogsplatViewer.workers,
      );
    } catch (error) {
      this.failed(error, "graphics");
      return;
    }
    const { scene } = this;
    scene.view = this.pose;
    scene.fillHoles = this.fills;
    this.panel = new Panel(
      this.find("#panel"),
      scene,
      {
        reload: () => void (this.source !== undefined && this.load(this.source)),
        chooseOther: () => this.find<HTMLInputElement>("#file").click(),
      },
      signal,
    );
    this.strip = new FilmStrip(this.find("#strip"), canvas, scene);
    this.divide = new Divide(this.find("#divide"), (share) => scene.show({ divide: share }), signal);
    this.listen(signal);
    for (const name of CogsplatViewer.observedAttributes) {
      if (name !== "src" && name !== "against") this.apply(name, this.getAttribute(name));
    }
    if (this.source !== undefined) void this.load(this.source);
    else this.apply("src", this.getAttribute("src"));
    this.changed();
  }

  disconnectedCallback(): void {
    this.abort?.abort();
    clearTimeout(this.quiet);
    this.scene?.dispose();
    this.scene = undefined;
    this.shadow.replaceChildren();
  }

  attributeChangedCallback(name: string, before: string | null, value: string | null): void {
    if (this.scene !== undefined && before !== value) this.apply(name, value);
  }

  private get root(): HTMLElement | null {
    return this.shadow.querySelector("#root");
  }

  private find<E extends HTMLElement>(selector: string): E {
    return this.shadow.querySelector<E>(selector)!;
  }

  private apply(name: string, value: string | null): void {
    const scene = this.scene!;
    if (name === "src" && value !== null) {
      const against = this.getAttribute("against");
      void this.load(new URL(value, document.baseURI).href);
      if (against !== null) this.apply("against", against);
    } else if (name === "against") {
      void this.compare(value === null ? undefined : new URL(value, document.baseURI).href);
    } else if (name === "background") {
      const colour = colourOf(value ?? "black");
      if (colour === undefined) return;
      scene.show({ background: colour });
      this.panel!.background = `#${colour
        .slice(0, 3)
        .map((share) =>
          Math.round(255 * share)
            .toString(16)
            .padStart(2, "0"),
        )
        .join("")}`;
      // What is not covered by splats is as clear as the background.
      this.style.background = value ?? "";
    } else if (name === "sh-degree") scene.show({ degree: value === null ? 3 : Number(value) });
    else if (name === "level") {
      scene.level = value === null || !Number.isFinite(Number(value)) ? undefined : Number(value);
      this.panel!.offerLevels(scene.levels, scene.level);
    } else if (name === "splat-budget") {
      const phone = matchMedia("(pointer: coarse)").matches;
      scene.limit(value === null ? (phone ? BUDGET_OF_PHONES : Infinity) : Number(value));
    } else if (name === "order") scene.order = value === "view" || value === "file" ? value : undefined;
    else if (name === "pixel-ratio") scene.mostPixelRatio = value === null ? 2 : Number(value);
    else if (name === "resolution") scene.mayHaste = value !== "full";
    else if (name === "fill-holes") this.fillHoles = value !== "off";
    else if (name === "controls") this.find("#tools").hidden = value === "none";
    else if (name === "label" || name === "against-label") this.nameScenes();
  }

  private listen(signal: AbortSignal): void {
    const click = (id: string, act: () => void): void => this.find(`#${id}`).addEventListener("click", act, { signal });
    click("reset", () => this.scene!.reset());
    click("film", () => this.toggleStrip());
    click("settings", () => this.togglePanel());
    click("full", () => void this.toggleFullScreen());
    click("again", () => void (this.source !== undefined && this.load(this.source)));
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
        // Keys that are typed into a field are no commands.
        const inField = event
          .composedPath()
          .some((target) => target instanceof HTMLInputElement || target instanceof HTMLSelectElement);
        if (event.ctrlKey || event.metaKey || event.altKey || (inField && event.code !== "Escape")) return;
        const command = {
          KeyR: () => this.scene!.reset(),
          KeyF: () => void this.toggleFullScreen(),
          KeyG: () => this.togglePanel(),
          KeyT: () => this.toggleStrip(),
          Escape: () => this.closeAll(),
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

  private togglePanel(): void {
    const panel = this.find("#panel");
    if (this.strip!.isOpen) this.toggleStrip();
    panel.hidden = !panel.hidden;
    this.find("#settings").setAttribute("aria-expanded", String(!panel.hidden));
    if (!panel.hidden) this.find("#panel select").focus();
    this.changed();
  }

  private toggleStrip(): void {
    const { strip } = this;
    if (strip!.isOpen) strip!.close();
    else {
      if (!this.find("#panel").hidden) this.togglePanel();
      void strip!.open();
    }
    this.find("#film").setAttribute("aria-expanded", String(strip!.isOpen));
  }

  private closeAll(): void {
    if (!this.find("#panel").hidden) this.togglePanel();
    if (this.strip!.isOpen) this.toggleStrip();
  }

  private async toggleFullScreen(): Promise<void> {
    if (this.matches(":fullscreen")) await document.exitFullscreen();
    else await this.requestFullscreen();
  }

  /** Show how far the scene has come. */
  private changed(): void {
    const { scene } = this;
    const root = this.root;
    if (scene === undefined || root === null) return;
    const { statistics } = scene;
    const { state, splats, totalSplats, bytes, totalBytes, predictedDb } = statistics;
    root.classList.toggle("empty", state === "empty");
    root.classList.toggle("failed", state === "failed" && !scene.isShown);
    if (scene.isShown) root.classList.add("shown");
    this.find("#hint").textContent =
      state === "empty"
        ? "Drop a .cogs file or a PLY of splats here."
        : state === "opening"
          ? "Opening …"
          : `Loading … ${sizeText(bytes)}`;
    const share = totalBytes === undefined ? splats / Math.max(totalSplats, 1) : bytes / totalBytes;
    const done = state === "complete";
    this.find("#line > div").style.transform = `scaleX(${done ? 1 : Math.min(share, 1)})`;
    this.find("#line").setAttribute("aria-valuenow", String(Math.round(100 * (done ? 1 : share))));
    const texts = [
      totalBytes !== undefined && !done
        ? `${sizeText(Math.min(bytes, totalBytes))} of ${sizeText(totalBytes)}`
        : sizeText(totalBytes ?? bytes),
      `${splats.toLocaleString()} splats`,
      ...(predictedDb === undefined ? [] : [`${predictedDb.toFixed(1)} dB predicted`]),
    ];
    const progress = this.find("#progress");
    const text = totalSplats > 0 ? texts.join(" · ") : "Opening …";
    if (progress.textContent !== text) progress.textContent = text;
    this.panel?.update(statistics, this.find("canvas"));
    if (state !== this.lastState) this.entered(state);
    this.dispatchEvent(new Event("cogsplat-change"));
  }

  private lastState: ViewerStatistics["state"] | undefined;

  private entered(state: ViewerStatistics["state"]): void {
    this.lastState = state;
    clearTimeout(this.quiet);
    this.root!.classList.remove("quiet");
    if (state === "streaming") {
      const wanted = Number(this.getAttribute("sh-degree") ?? 3);
      this.panel!.offerDegrees(this.scene!.degree, wanted);
      this.panel!.offerLevels(this.scene!.levels, this.scene!.level);
    } else if (state === "complete") {
      this.quiet = setTimeout(() => this.root?.classList.add("quiet"), QUIET_AFTER);
    }
  }

  private nameScenes(): void {
    const { source, otherSource } = this;
    if (this.root === null) return;
    const name = this.getAttribute("label") ?? nameOf(source);
    this.find("canvas").setAttribute("aria-label", name === "" ? "Splat scene" : `Splat scene ${name}`);
    const compares = otherSource !== undefined && (this.scene?.compares ?? false);
    this.find("#sceneName").textContent = name;
    const given = otherSource instanceof File ? null : this.getAttribute("against-label");
    this.find("#otherName").textContent = given ?? nameOf(otherSource);
    for (const id of ["#sceneName", "#otherName"]) this.find(id).hidden = !compares;
    if (this.divide) this.divide.shown = compares;
  }

  private failed(error: unknown, which: "scene" | "other" | "graphics"): void {
    if (which === "graphics" && error === undefined) {
      this.say(
        {
          title: "The graphics were interrupted",
          detail: "The scene comes back as soon as the browser has them again.",
        },
        false,
      );
      return;
    }
    const sentence = describe(error, this.scene?.isShown ?? false);
    if (which === "other") {
      this.otherSource = undefined;
      this.nameScenes();
      this.say({ ...sentence, title: `Nothing to compare with: ${sentence.title.toLowerCase()}` }, false);
    } else this.say(sentence);
    this.changed();
  }

  /** Show a sentence, or take it away; `again` offers to load the scene once more. */
  private say(sentence: Sentence | undefined, again = this.source !== undefined): void {
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

/** The name of a source's file. */
function nameOf(source: SceneSource | undefined): string {
  if (source instanceof File) return source.name;
  if (typeof source !== "string") return "";
  return decodeURIComponent(new URL(source, location.href).pathname.split("/").at(-1)!);
}

/** Make `<cogsplat-viewer>` known to the page; a second copy of this program leaves it to the first. */
export function defineViewer(): void {
  if (customElements.get("cogsplat-viewer") === undefined) customElements.define("cogsplat-viewer", CogsplatViewer);
}

declare global {
  interface HTMLElementTagNameMap {
    "cogsplat-viewer": CogsplatViewer;
  }
}
