import type { LevelEntry } from "../container/root.js";
import type { Movement } from "./controls.js";
import { parseColour } from "./numbers.js";
import { element } from "./page_parts.js";
import { PANEL_MARKUP } from "./panel_markup.js";
import type { Stage } from "./stage.js";

/** Functions of the viewer that the panel needs in addition to the scene view. */
export interface PanelHost {
  reload(): void;
  chooseOther(): void;
  /** Turn by itself, or stop. */
  rotate(turns: boolean): void;
  isTurning(): boolean;
  copyView(): void;
  measure(): void;
  /** Write, or read from a file, SuperSplat's settings. */
  exportSettings(): void;
  importSettings(file: File): void;
}

/** The settings: a form whose fields take effect at once. */
export class Panel {
  private readonly form = element("form", "panel glass");
  private readonly fields = this.form.elements;
  private readonly table: HTMLTableElement;

  /** @param button - Button that opens the settings. */
  constructor(
    private readonly stage: Pick<Stage, "scene" | "canvas" | "foot" | "closePanels">,
    private readonly button: HTMLElement,
    private readonly host: PanelHost,
  ) {
    const { form } = this;
    form.id = "panel";
    form.ariaLabel = "Settings";
    form.hidden = true;
    form.innerHTML = PANEL_MARKUP;
    stage.foot.before(form);
    this.table = form.querySelector("table")!;
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("input", (event) => this.changed((event.target as HTMLInputElement).name));
    const click = (id: string, act: () => void): void => form.querySelector(id)!.addEventListener("click", act);
    click("#reload", () => host.reload());
    click("#choose", () => host.chooseOther());
    click("#copyView", () => host.copyView());
    click("#export", () => host.exportSettings());
    const file = form.querySelector<HTMLInputElement>("#settingsFile")!;
    click("#import", () => file.click());
    file.addEventListener("change", () => {
      const [chosen] = file.files!;
      if (chosen !== undefined) host.importSettings(chosen);
      file.value = "";
    });
    click("#measure", () => {
      this.close();
      host.measure();
    });
  }

  get isOpen(): boolean {
    return !this.form.hidden;
  }

  /** Open the settings as the scene is shown. */
  open(): void {
    this.stage.closePanels();
    this.form.hidden = false;
    this.button.ariaExpanded = "true";
    this.showScene();
    this.form.querySelector("select")!.focus();
  }

  close(): void {
    if (!this.isOpen) return;
    if (this.form.contains((this.form.getRootNode() as ShadowRoot).activeElement)) this.button.focus();
    this.form.hidden = true;
    this.button.ariaExpanded = "false";
  }

  /** Show in the fields how the scene is shown. */
  showScene(): void {
    const { scene } = this.stage;
    const { background, degree } = scene.options;
    const bytes = background.slice(0, 3).map((share) => Math.round(255 * share));
    this.offerDegrees(scene.degree, degree);
    this.offerLevels(scene.levels, scene.level);
    this.background = `#${bytes.map((byte) => byte.toString(16).padStart(2, "0")).join("")}`;
    this.field("fill").checked = scene.fillHoles;
    this.field("turns").checked = this.host.isTurning();
    this.update();
  }

  /** Set the field of the background colour. */
  private set background(colour: string) {
    const select = this.field("background");
    const known = [...(select as unknown as HTMLSelectElement).options].some((option) => option.value === colour);
    select.value = known ? colour : "custom";
    this.field("custom").value = colour;
    this.customRow.hidden = known;
  }

  /** Offer the SH degrees of a scene. */
  private offerDegrees(most: number, chosen: number): void {
    const select = this.field("degree") as unknown as HTMLSelectElement;
    const options = Array.from({ length: most + 1 }, (_, degree) => {
      const text = degree === 0 ? "0: none" : String(degree);
      return new Option(text, String(degree), false, degree === Math.min(chosen, most));
    });
    select.replaceChildren(...options);
  }

  /** Offer the levels of a scene, if any. */
  private offerLevels(levels: readonly LevelEntry[], chosen: number | undefined): void {
    this.form.querySelector<HTMLElement>("#levelRow")!.hidden = levels.length === 0;
    const select = this.field("level") as unknown as HTMLSelectElement;
    const options = levels.map(({ scale }, level) => {
      const text = scale === 1 ? "For full size" : `For 1/${Number(scale.toPrecision(3))} of it`;
      return new Option(text, String(level), false, level === chosen);
    });
    select.replaceChildren(new Option("By the picture's size", ""), ...options);
    // A level between two is the choice of the page's program.
    if (chosen !== undefined && !Number.isInteger(chosen))
      select.append(new Option(`Between: ${chosen}`, String(chosen), false, true));
  }

  /** Update the statistics, if shown. */
  update(): void {
    if (this.table.hidden || this.form.hidden) return;
    const { scene, canvas } = this.stage;
    const { statistics } = scene;
    const { level } = statistics;
    const rows = [
      ...(level === undefined ? [] : [["Level", `${level.toFixed(2)} of 0 to ${scene.levels.length - 1}`]]),
      ["Splats drawn", scene.drawnRows.toLocaleString()],
      ["Picture", `${canvas.width} × ${canvas.height} px`],
      ["Pictures drawn", statistics.frames.toLocaleString()],
      ["Main thread", `${statistics.drawMilliseconds.toFixed(1)} ms a picture`],
      ["Graphics", `${statistics.pictureMilliseconds.toFixed(1)} ms a picture`],
      ["Sorting", `${statistics.sortMilliseconds.toFixed(1)} ms in a worker`],
    ];
    const body = this.table.tBodies[0]!;
    while (body.rows.length < rows.length) {
      const row = body.insertRow();
      row.insertCell();
      row.insertCell();
    }
    rows.forEach((texts, i) => {
      texts.forEach((text, j) => {
        body.rows[i]!.cells[j]!.textContent = text;
      });
    });
  }

  private get customRow(): HTMLElement {
    return this.form.querySelector<HTMLElement>("#customRow")!;
  }

  private field(name: string): HTMLInputElement {
    return this.fields.namedItem(name) as HTMLInputElement;
  }

  private changed(name: string): void {
    const { scene: view } = this.stage;
    const field = this.field(name);
    if (name === "degree") view.show({ degree: Number(field.value) });
    else if (name === "level") view.level = field.value === "" ? undefined : Number(field.value);
    else if (name === "budget")
      view.limit(
        field.value === "100" ? Infinity : Math.ceil((view.statistics.totalSplats * Number(field.value)) / 100),
      );
    else if (name === "movement") view.controls.movement = field.value as Movement;
    else if (name === "rate") view.meter.bitsPerSecond = Number(field.value) * 1e6;
    else if (name === "turns") this.host.rotate(field.checked);
    else if (name === "fill") view.fillHoles = field.checked;
    else if (name === "statistics") {
      this.table.hidden = !field.checked;
      view.redraw();
    } else {
      const chosen = this.field("background").value;
      this.customRow.hidden = chosen !== "custom";
      const colour = parseColour(chosen === "custom" ? this.field("custom").value : chosen);
      if (colour !== undefined) view.show({ background: colour });
    }
  }
}
