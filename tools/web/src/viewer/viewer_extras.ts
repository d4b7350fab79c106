// Program of the viewer's parts that are loaded when they are asked for.
import type { Description } from "../container/description.js";
import { DescribedScene } from "./described_scene.js";
import { EXTRAS_STYLE } from "./extras_style.js";
import { FilmStrip } from "./film_strip.js";
import { aheadOf, distance, flight, positionOf, translationOf } from "./flight.js";
import { Headset } from "./headset.js";
import { Measure } from "./measure.js";
import type { Vector } from "./orbit.js";
import { Panel, type PanelHost } from "./panel.js";
import { pick } from "./pick.js";
import type { DescriptionSource } from "./scene_feed.js";
import { type Projection, projectionOf, type Stage } from "./stage.js";
import { exportSettings, importSettings } from "./supersplat_settings.js";
import type { ViewerPose } from "./viewer_handle.js";

/** Share of the distance to a point that is left after a double click on it. */
const NEARER = 0.6;

/** Description of a scene without one. */
const NO_DESCRIPTION: Description = {
  title: undefined,
  text: undefined,
  licence: undefined,
  credits: undefined,
  date: undefined,
  metresPerUnit: undefined,
  unit: undefined,
  background: undefined,
  views: [],
  path: undefined,
  annotations: [],
  georeference: undefined,
  poster: undefined,
  sky: undefined,
};

/** Parts of the stage that the element gives. */
export type StageParts = Omit<Stage, "pick" | "projection" | "flyTo"> &
  Omit<PanelHost, "measure" | "exportSettings" | "importSettings">;

/** Parts of a viewer that its first picture does not need, such as focus and measuring. */
export class Extras {
  private readonly stage: Stage;
  private readonly strip: FilmStrip;
  private readonly panel: Panel;
  private measure: Measure | undefined;
  private headset: Headset | undefined;
  private described: DescribedScene | undefined;

  constructor(parts: StageParts) {
    this.stage = {
      ...parts,
      pick: (x, y) => this.pick(x, y),
      projection: () => this.projection(),
      flyTo: (pose) => this.flyTo(pose),
    };
    const button = (id: string): HTMLElement => parts.tools.querySelector(id)!;
    this.strip = new FilmStrip(this.stage, button("#film"));
    this.panel = new Panel(this.stage, button("#settings"), {
      ...parts,
      measure: () => this.toggleMeasure(),
      exportSettings: () => this.exportSettings(),
      importSettings: (file) => void this.importSettings(file),
    });
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

  /** Open or close the settings. */
  togglePanel(): void {
    if (this.panel.isOpen) this.panel.close();
    else this.panel.open();
  }

  /** Follow a change of the statistics; the scene may have been opened. */
  changed(isOpened: boolean): void {
    if (isOpened && this.panel.isOpen) this.panel.showScene();
    else this.panel.update();
  }

  /** Open or close the film strip. */
  toggleStrip(): void {
    if (this.strip.isOpen) this.strip.close();
    else {
      this.stage.closePanels();
      void this.strip.open();
    }
  }

  /** Begin or end measuring. */
  toggleMeasure(): void {
    if (this.measure !== undefined) {
      this.measure.close();
      return;
    }
    this.measure = new Measure(this.stage, this.description, () => {
      this.measure = undefined;
    });
  }

  /** Show the scene in the headset, or end that. */
  async toggleHeadset(): Promise<void> {
    if (this.headset !== undefined) {
      this.headset.end();
      return;
    }
    const { scene, hint } = this.stage;
    try {
      this.headset = await Headset.begin(scene, this.description.metresPerUnit, () => {
        this.headset = undefined;
      });
    } catch (error) {
      hint(`The headset cannot show the scene: ${(error as Error).message}`);
    }
  }

  /** Follow a picture that was drawn. */
  drawn(): void {
    this.measure?.drawn(this.projection());
    this.described?.drawn();
  }

  /** Follow the camera's rest. */
  rested(): void {
    this.described?.rested();
  }

  /** Follow the end of a motion. */
  motionEnded(): void {
    this.described?.motionEnded();
    if (this.panel.isOpen) this.panel.showScene();
  }

  /** Show annotations, camera path and sky of a scene's description, the sky once it has arrived. */
  async describe(source: DescriptionSource): Promise<void> {
    const described = this.showParts();
    const sky = this.description.sky === undefined ? undefined : await source.picture("sky");
    if (sky !== undefined && this.described === described) await described.showSky(sky);
  }

  /** Show the card of an annotation, by its number from 0. */
  showAnnotation(number: number): void {
    this.described?.showAnnotation(number);
  }

  private get description(): Description {
    return this.stage.description() ?? NO_DESCRIPTION;
  }

  private showParts(): DescribedScene {
    this.described = new DescribedScene(this.stage, this.description);
    return this.described;
  }

  /** Offer SuperSplat's settings for download: the description, and the present pose. */
  private exportSettings(): void {
    const { scene } = this.stage;
    if (scene.camera.pose === undefined) return;
    const text = JSON.stringify(
      exportSettings(this.description, scene.camera.pose, { axes: scene.axes, up: scene.camera.up! }),
      undefined,
      2,
    );
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = "settings.json";
    link.click();
    URL.revokeObjectURL(link.href);
  }

  /** Show background, path and annotations of SuperSplat's settings in place of the description's. */
  private async importSettings(file: File): Promise<void> {
    const { scene, hint } = this.stage;
    if (scene.camera.up === undefined) return;
    try {
      const { parts, start } = importSettings(await file.text(), { axes: scene.axes, up: scene.camera.up });
      const { described } = this;
      this.stage.describe({ ...this.description, ...parts });
      const shown = this.showParts();
      described?.moveSky(shown);
      described?.remove();
      if (start !== undefined) this.flyTo(start);
    } catch (error) {
      if (!(error instanceof SyntaxError)) throw error;
      hint(`${file.name} cannot be used: ${error.message}`);
    }
  }

  /** Close what these parts show over the picture. */
  closePanels(): void {
    this.strip.close();
    this.panel.close();
    this.described?.showAnnotation(undefined);
  }

  /** Forget the scene: another is loaded. */
  clear(): void {
    this.headset?.end();
    this.strip.close();
    this.described?.remove();
    this.measure?.close();
    this.described = undefined;
  }

  private projection(): Projection | undefined {
    const { canvas, scene } = this.stage;
    return scene.camera.pose && projectionOf(scene.camera.pose, canvas.clientWidth, canvas.clientHeight);
  }

  /** Fly to a pose. */
  flyTo(to: ViewerPose): void {
    const { scene } = this.stage;
    const from = scene.camera.pose;
    if (from !== undefined) scene.camera.move(flight(from, to));
  }

  /** Bring the point at a place of the canvas into the middle, nearer. */
  private focus(x: number, y: number): void {
    const { scene } = this.stage;
    const from = scene.camera.pose;
    const target = this.pick(x, y);
    if (from === undefined || target === undefined) return;
    const far = NEARER * distance(positionOf(from), target);
    const position = aheadOf(from, target, -far);
    this.flyTo({ ...from, translation: translationOf(from.rotation, position), target });
  }

  private pick(x: number, y: number): Vector | undefined {
    const { scene, canvas } = this.stage;
    const { packed } = scene;
    const { pose } = scene.camera;
    if (pose === undefined || packed === undefined) return undefined;
    const { rotation: r, fx, fy, height, width = 1 } = pose;
    const scale = height / canvas.clientHeight;
    const inCamera = [(scale * x - width / 2) / fx, (scale * y - height / 2) / fy, 1];
    const size = Math.hypot(...inCamera);
    const direction = [0, 1, 2].map(
      (i) => inCamera.reduce((sum, value, row) => sum + value * r[3 * row + i]!, 0) / size,
    ) as Vector;
    const position = positionOf(pose);
    const origin = position.map((value, i) => value + packed.shift[i]!) as Vector;
    const far = pick(packed.shaderRows, packed.rows, { origin, direction, pixel: 1 / fy });
    return far === undefined ? undefined : (position.map((value, i) => value + far * direction[i]!) as Vector);
  }
}

// A page that holds this program as a text takes it from this event: a script in a page exports nothing.
document.dispatchEvent(new CustomEvent("cogsplat-extras", { detail: { Extras } }));
