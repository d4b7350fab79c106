import type { Annotation } from "../container/description.js";
import { distance, positionOf } from "./flight.js";
import { element } from "./page_parts.js";
import type { Projection, Stage } from "./stage.js";

/** Share of the distance to a place: splats nearer than this cover its pin. */
const COVERED = 0.95;

/** Buttons at places of the scene, each with a card of its text. */
export class Annotations {
  private readonly pins: readonly HTMLButtonElement[];
  private readonly card: HTMLElement;
  private readonly heading = document.createElement("h2");
  private readonly text = document.createElement("p");
  private readonly close = element("button", "close", "×");
  private open: number | undefined;
  /** Number of the last check for covered pins; an earlier check that still runs ends. */
  private looks = 0;

  constructor(
    private readonly stage: Stage,
    private readonly annotations: readonly Annotation[],
  ) {
    this.pins = annotations.map(({ title }, i) => {
      const pin = element("button", "pin", String(i + 1));
      pin.ariaLabel = `${i + 1}: ${title}`;
      pin.title = title;
      pin.ariaExpanded = "false";
      pin.hidden = true;
      pin.addEventListener("click", () => this.show(this.open === i ? undefined : i));
      return pin;
    });
    const { close } = this;
    close.ariaLabel = "Close";
    close.addEventListener("click", () => this.show(undefined));
    this.card = element("div", "panel card glass", this.heading, this.text, close);
    this.card.ariaLive = "polite";
    this.card.hidden = true;
    stage.overlay.append(...this.pins);
    stage.foot.before(this.card);
    this.drawn(stage.projection());
  }

  /** Show the card of an annotation, and fly to its view; undefined closes the card. */
  show(number: number | undefined): void {
    const { card, pins, stage } = this;
    const focused = (card.getRootNode() as ShadowRoot).activeElement;
    if (number !== undefined) stage.closePanels();
    else if (card.contains(focused)) (pins[this.open!]!.hidden ? stage.canvas : pins[this.open!]!).focus();
    this.open = number;
    pins.forEach((pin, i) => {
      pin.ariaExpanded = String(i === number);
    });
    card.hidden = number === undefined;
    if (number === undefined) return;
    const { title, text, view } = this.annotations[number]!;
    this.heading.textContent = title;
    this.text.textContent = text;
    this.text.hidden = text === "";
    this.close.focus();
    if (view !== undefined) stage.flyTo(view);
  }

  /** Move each pin to its place in the picture; hide a pin behind the camera or outside the picture. */
  drawn(projection: Projection | undefined): void {
    this.annotations.forEach(({ place }, i) => {
      const pin = this.pins[i]!;
      const at = projection?.place(place);
      const isInside =
        at !== undefined && at[0] >= 0 && at[1] >= 0 && at[0] <= projection!.width && at[1] <= projection!.height;
      pin.hidden = !isInside;
      if (isInside) pin.style.transform = `translate(${at[0]}px, ${at[1]}px)`;
    });
  }

  /** Find out, one by one, which pins the scene covers. */
  async rested(): Promise<void> {
    const look = ++this.looks;
    const { scene } = this.stage;
    for (const [i, { place }] of this.annotations.entries()) {
      const at = this.stage.projection()?.place(place);
      if (this.pins[i]!.hidden || at === undefined || scene.camera.pose === undefined) continue;
      const position = positionOf(scene.camera.pose);
      const front = this.stage.pick(...at);
      const isCovered = front !== undefined && distance(front, position) < COVERED * distance(place, position);
      this.pins[i]!.classList.toggle("covered", isCovered);
      await new Promise((resolve) => setTimeout(resolve, 0));
      if (look !== this.looks) return;
    }
  }

  /** Remove pins and card from the page. */
  remove(): void {
    this.looks++;
    for (const part of [this.card, ...this.pins]) part.remove();
  }
}
