import type { LevelEntry } from "../container/root.js";
import type { Movement } from "./controls.js";
import { parseColour } from "./numbers.js";
import type { SceneView } from "./scene_view.js";
import type { ViewerStatistics } from "./viewer_handle.js";

/** Functions of the viewer that the panel needs in addition to the scene view. */
export interface PanelHost {
  reload(): void;
  chooseOther(): void;
  /** Turn by itself, or stop. */
  rotate(turns: boolean): void;
}

/** The settings: a form whose fields take effect at once. */
export class Panel {
  private readonly fields: HTMLFormControlsCollection;
  private readonly table: HTMLTableElement;

  constructor(
    private readonly form: HTMLFormElement,
    private readonly view: SceneView,
    private readonly host: PanelHost,
    signal: AbortSignal,
  ) {
    this.fields = form.elements;
    this.table = form.querySelector("table")!;
    form.addEventListener("submit", (event) => event.preventDefault(), { signal });
    form.addEventListener("input", (event) => this.changed((event.target as HTMLInputElement).name), { signal });
    form.querySelector("#reload")!.addEventListener("click", () => host.reload(), { signal });
    form.querySelector("#choose")!.addEventListener("click", () => host.chooseOther(), { signal });
  }

  /** Set the field of the background colour. */
  set background(colour: string) {
    const select = this.field("background");
    const known = [...(select as unknown as HTMLSelectElement).options].some((option) => option.value === colour);
    select.value = known ? colour : "custom";
    this.field("custom").value = colour;
    this.customRow.hidden = known;
  }

  /** Show whether the camera turns by itself. */
  showRotation(turns: boolean): void {
    this.field("turns").checked = turns;
  }

  /** Offer the SH degrees of a scene. */
  offerDegrees(most: number, chosen: number): void {
    const select = this.field("degree") as unknown as HTMLSelectElement;
    const options = Array.from({ length: most + 1 }, (_, degree) => {
      const text = degree === 0 ? "0: none" : String(degree);
      return new Option(text, String(degree), false, degree === Math.min(chosen, most));
    });
    select.replaceChildren(...options);
  }

  /** Offer the levels of a scene, if any. */
  offerLevels(levels: readonly LevelEntry[], chosen: number | undefined): void {
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
  update(statistics: ViewerStatistics, canvas: HTMLCanvasElement): void {
    if (this.table.hidden || this.form.hidden) return;
    const { level } = statistics;
    const rows = [
      ...(level === undefined ? [] : [["Level", `${level.toFixed(2)} of 0 to ${this.view.levels.length - 1}`]]),
      ["Splats drawn", this.view.drawnRows.toLocaleString()],
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
    const { view } = this;
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
