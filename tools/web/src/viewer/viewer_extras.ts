// Program of the viewer's parts that are loaded when they are asked for.
import { EXTRAS_STYLE } from "./extras_style.js";
import { aheadOf, distance, flight, positionOf, translationOf } from "./flight.js";
import { Measure, type Scale } from "./measure.js";
import type { Vector } from "./orbit.js";
import { pick } from "./pick.js";
import { type Projection, projectionOf, type Stage } from "./stage.js";
import type { ViewerPose } from "./viewer_handle.js";

/** Share of the distance to a point that is left after a double click on it. */
const NEARER = 0.6;

/** Parts of the stage that the element gives. */
export type StageParts = Omit<Stage, "pick" | "projection" | "flyTo">;

/** Focus, measuring and other parts of one viewer that its first picture does not need. */
export class Extras {
  private readonly stage: Stage;
  private measure: Measure | undefined;

  constructor(parts: StageParts) {
    this.stage = {
      ...parts,
      pick: (x, y) => this.pick(x, y),
      projection: () => this.projection(),
      flyTo: (pose) => this.flyTo(pose),
    };
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(EXTRAS_STYLE);
    const shadow = parts.root.getRootNode() as ShadowRoot;
    shadow.adoptedStyleSheets = [...shadow.adoptedStyleSheets, sheet];
  }

  /** Handle a tap or a click on the canvas, px. */
  tapped(x: number, y: number, isDouble: boolean): void {
    if (this.measure !== undefined) this.measure.tapped(x, y);
    else if (isDouble) this.focus(x, y);
  }

  /** Begin or end measuring. */
  toggleMeasure(): void {
    if (this.measure !== undefined) {
      this.measure.close();
      return;
    }
    this.measure = new Measure(this.stage, this.scale, () => {
      this.measure = undefined;
    });
  }

  /** Follow a picture that was drawn. */
  drawn(): void {
    this.measure?.drawn(this.projection());
  }

  private projection(): Projection | undefined {
    const { canvas, scene } = this.stage;
    return scene.view && projectionOf(scene.view, canvas.clientWidth, canvas.clientHeight);
  }

  private get scale(): Scale {
    return { metresPerUnit: undefined, unit: undefined };
  }

  /** Fly to a pose. */
  private flyTo(to: ViewerPose): void {
    const { scene } = this.stage;
    const from = scene.view;
    if (from !== undefined) scene.move(flight(from, to));
  }

  /** Bring the point at a place of the canvas into the middle, nearer. */
  private focus(x: number, y: number): void {
    const { scene } = this.stage;
    const from = scene.view;
    const target = this.pick(x, y);
    if (from === undefined || target === undefined) return;
    const far = NEARER * distance(positionOf(from), target);
    const position = aheadOf(from, target, -far);
    this.flyTo({ ...from, translation: translationOf(from.rotation, position), target });
  }

  private pick(x: number, y: number): Vector | undefined {
    const { scene, canvas } = this.stage;
    const { view, packed } = scene;
    if (view === undefined || packed === undefined) return undefined;
    const { rotation: r, fx, fy, height, width = 1 } = view;
    const scale = height / canvas.clientHeight;
    const inCamera = [(scale * x - width / 2) / fx, (scale * y - height / 2) / fy, 1];
    const size = Math.hypot(...inCamera);
    const direction = [0, 1, 2].map(
      (i) => inCamera.reduce((sum, value, row) => sum + value * r[3 * row + i]!, 0) / size,
    ) as Vector;
    const position = positionOf(view);
    const origin = position.map((value, i) => value + packed.shift[i]!) as Vector;
    const far = pick(packed.words, packed.rows, { origin, direction, pixel: 1 / fy });
    return far === undefined ? undefined : (position.map((value, i) => value + far * direction[i]!) as Vector);
  }
}

// A page that holds this program as a text takes it from this event: a script in a page exports nothing.
document.dispatchEvent(new CustomEvent("cogsplat-extras", { detail: { Extras } }));
