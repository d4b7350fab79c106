import { distance } from "./flight.js";
import type { Vector } from "./orbit.js";
import type { Projection, Stage } from "./stage.js";

/** Metres of the units in which lengths are shown. */
const METRES: Readonly<Record<string, number>> = { mm: 1e-3, cm: 1e-2, m: 1, km: 1e3, in: 0.0254, ft: 0.3048 };

/** Scale of a scene: metres of a scene unit, and the unit in which lengths are shown. */
export interface Scale {
  readonly metresPerUnit: number | undefined;
  readonly unit: string | undefined;
}

/** Format a length of the scene; without a scale in scene units. */
export function formatLength(length: number, { metresPerUnit, unit = "m" }: Scale): string {
  if (metresPerUnit === undefined) return `${Number(length.toPrecision(3)).toLocaleString()} scene units`;
  return `${Number(((length * metresPerUnit) / METRES[unit]!).toPrecision(3)).toLocaleString()} ${unit}`;
}

/** Measures the distance between two points that a person taps, or picks with Enter in the middle of the picture. */
export class Measure {
  private readonly abort = new AbortController();
  private readonly bar = document.createElement("div");
  private readonly text = document.createElement("span");
  private readonly line = document.createElement("div");
  private readonly dots = [0, 1].map(() => document.createElement("div"));
  private points: Vector[] = [];

  constructor(
    private readonly stage: Stage,
    private readonly scale: Scale,
    private readonly closed: () => void,
  ) {
    const { bar, text, line, dots } = this;
    const close = document.createElement("button");
    bar.className = "bar glass";
    bar.role = "group";
    bar.ariaLabel = "Measure";
    text.ariaLive = "polite";
    line.className = "measured";
    for (const dot of dots) dot.className = "dot";
    close.textContent = "Done";
    close.addEventListener("click", () => this.close());
    bar.append(text, close);
    stage.overlay.append(line, ...dots, bar);
    stage.root.classList.add("measuring");
    stage.canvas.addEventListener(
      "keydown",
      (event) => {
        if (event.key === "Enter") this.put(stage.pick(stage.canvas.clientWidth / 2, stage.canvas.clientHeight / 2));
        else if (event.key === "Escape") this.close();
        else return;
        event.preventDefault();
        event.stopPropagation();
      },
      { signal: this.abort.signal },
    );
    stage.canvas.focus();
    this.show();
  }

  /** Put the next point where a person taps. */
  tapped(x: number, y: number): void {
    this.put(this.stage.pick(x, y));
  }

  /** Move the line to where the points are in a picture. */
  drawn(projection: Projection | undefined): void {
    const [a, b] = this.points.map((point) => projection?.place(point));
    this.dots.forEach((dot, i) => {
      const at = [a, b][i];
      dot.hidden = at === undefined;
      if (at !== undefined) dot.style.transform = `translate(${at[0]}px, ${at[1]}px)`;
    });
    this.line.hidden = a === undefined || b === undefined;
    if (a === undefined || b === undefined) return;
    const angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
    this.line.style.transform = `translate(${a[0]}px, ${a[1]}px) rotate(${angle}rad)`;
    this.line.style.width = `${Math.hypot(b[0] - a[0], b[1] - a[1])}px`;
  }

  close(): void {
    this.abort.abort();
    for (const element of [this.bar, this.line, ...this.dots]) element.remove();
    this.stage.root.classList.remove("measuring");
    this.stage.canvas.focus();
    this.closed();
  }

  private put(point: Vector | undefined): void {
    if (point === undefined) {
      this.stage.hint("Nothing is there to measure");
      return;
    }
    this.points = this.points.length === 2 ? [point] : [...this.points, point];
    this.show();
  }

  private show(): void {
    const [a, b] = this.points;
    this.text.textContent =
      a === undefined
        ? "Measure: choose the first point"
        : b === undefined
          ? "Choose the second point"
          : formatLength(distance(a, b), this.scale);
    this.drawn(this.stage.projection());
  }
}
