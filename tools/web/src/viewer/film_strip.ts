import { formatBytes } from "./numbers.js";
import { element } from "./page_parts.js";
import type { Prefix } from "./scene_feed.js";
import type { SceneView } from "./scene_view.js";
import type { Stage } from "./stage.js";

/** Maximum number of pictures in a strip. */
const PICTURES = 6;
/** Size of a picture, device pixels. */
const [WIDTH, HEIGHT] = [256, 160];

/** Strip of pictures of a scene after growing prefixes of its file; a click on one shows that prefix. */
export class FilmStrip {
  /** Number of the latest call of `open` or `close`; an earlier `open` stops when it differs. */
  private run = 0;

  private readonly strip = element("div", "strip glass");
  private readonly canvas: HTMLCanvasElement;
  private readonly view: SceneView;

  /** @param button - Button that opens the strip. */
  constructor(
    { canvas, scene, foot }: Pick<Stage, "canvas" | "scene" | "foot">,
    private readonly button: HTMLElement,
  ) {
    this.canvas = canvas;
    this.view = scene;
    this.strip.id = "strip";
    this.strip.role = "group";
    this.strip.ariaLabel = "The scene after parts of its file";
    this.strip.hidden = true;
    foot.before(this.strip);
  }

  get isOpen(): boolean {
    return !this.strip.hidden;
  }

  /** Render each prefix from the present pose and show the pictures. */
  async open(): Promise<void> {
    const run = ++this.run;
    const prefixes = this.view.prefixes(PICTURES);
    this.strip.replaceChildren();
    this.strip.hidden = prefixes.length === 0;
    this.button.ariaExpanded = String(this.isOpen);
    // Small pictures are rendered at low resolution.
    this.view.pixelRatio = Math.max(WIDTH / this.canvas.clientWidth, HEIGHT / this.canvas.clientHeight);
    for (const prefix of prefixes) {
      this.view.showPrefix(prefix);
      await this.view.settled();
      if (run !== this.run) return;
      this.strip.append(this.frame(prefix, prefixes.at(-1) === prefix));
    }
    this.view.pixelRatio = undefined;
    this.choose(this.strip.lastElementChild as HTMLButtonElement, undefined);
  }

  /** Remove the strip and show the whole scene. */
  close(): void {
    if (!this.isOpen) return;
    this.run++;
    this.strip.hidden = true;
    this.button.ariaExpanded = "false";
    this.strip.replaceChildren();
    this.view.pixelRatio = undefined;
    this.view.showPrefix(undefined);
  }

  /**
   * Return the button of a prefix, with a copy of the picture on the canvas.
   *
   * @param isWhole - Whether the prefix is the whole file.
   */
  private frame(prefix: Prefix, isWhole: boolean): HTMLButtonElement {
    const button = document.createElement("button");
    const picture = document.createElement("canvas");
    [picture.width, picture.height] = [WIDTH, HEIGHT];
    const { canvas } = this;
    // The centre of the canvas, in the aspect ratio of the strip.
    const scale = Math.min(canvas.width / WIDTH, canvas.height / HEIGHT);
    const [width, height] = [WIDTH * scale, HEIGHT * scale];
    picture
      .getContext("2d")!
      .drawImage(canvas, (canvas.width - width) / 2, (canvas.height - height) / 2, width, height, 0, 0, WIDTH, HEIGHT);
    const decibels = prefix.predictedDb === undefined ? "" : ` · ${prefix.predictedDb.toFixed(1)} dB`;
    const text = `${formatBytes(prefix.bytes)}${decibels}`;
    button.append(picture, text);
    button.setAttribute("aria-label", `The scene after ${text}`);
    button.addEventListener("click", () => this.choose(button, isWhole ? undefined : prefix));
    return button;
  }

  /** Mark a button as pressed and show its prefix; undefined shows the whole scene. */
  private choose(button: HTMLButtonElement | null, prefix: Prefix | undefined): void {
    for (const child of this.strip.children) child.setAttribute("aria-pressed", String(child === button));
    this.view.showPrefix(prefix);
  }
}
