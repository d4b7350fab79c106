import type { Description, NamedView } from "../container/description.js";
import { element } from "./page_parts.js";

/** Functions of the viewer that the panel of a description needs. */
export interface AboutHost {
  /** Layer over the canvas, for the caption. */
  readonly overlay: HTMLElement;
  /** Row of the tools; panels stand in the column above it. */
  readonly foot: HTMLElement;
  closePanels(): void;
  flyTo(view: NamedView): void;
  showAnnotation(number: number): void;
}

/** Caption with the title of a scene, and a panel with its texts, its credits and lists of views and annotations. */
export class About {
  private readonly caption: HTMLButtonElement | undefined;
  private readonly panel = element("section", "panel about glass");
  private readonly closer = element("button", "close", "×");

  constructor(
    private readonly host: AboutHost,
    readonly description: Description,
  ) {
    const { title = "About this scene", text, credits, licence, date, views, annotations } = description;
    const rights = [credits, licence].filter(Boolean);
    const { panel, closer } = this;
    const list = (heading: string, texts: readonly string[], act: (number: number) => void): void => {
      if (texts.length === 0) return;
      const items = texts.map((text, number) => {
        const button = element("button", "wide", text);
        button.addEventListener("click", () => act(number));
        return element("li", "", button);
      });
      panel.append(element("h3", "", heading), element("ul", "", ...items));
    };
    panel.ariaLabel = "About this scene";
    panel.hidden = true;
    closer.ariaLabel = "Close";
    closer.addEventListener("click", () => this.toggle());
    panel.append(closer, element("h2", "", title));
    if (text !== undefined) panel.append(element("p", "text", text));
    for (const line of [...rights, date]) if (line) panel.append(element("p", "rights", line));
    const names = views.map(({ name }) => name);
    list("Views", names, (number) => host.flyTo(views[number]!));
    const titles = annotations.map((annotation, i) => `${i + 1}: ${annotation.title}`);
    list("Annotations", titles, (number) => host.showAnnotation(number));
    host.foot.before(panel);
    if (description.title === undefined && panel.childElementCount <= 2) return;
    this.caption = element("button", "caption glass", element("b", "", title));
    if (rights.length > 0) this.caption.append(element("span", "", rights.join(" · ")));
    this.caption.ariaExpanded = "false";
    this.caption.addEventListener("click", () => this.toggle());
    host.overlay.append(this.caption);
  }

  close(): void {
    if (!this.panel.hidden) this.toggle();
  }

  remove(): void {
    this.caption?.remove();
    this.panel.remove();
  }

  private toggle(): void {
    const { panel, caption } = this;
    const opens = panel.hidden;
    if (opens) this.host.closePanels();
    const isFocused = panel.contains((panel.getRootNode() as ShadowRoot).activeElement);
    panel.hidden = !opens;
    if (caption) caption.ariaExpanded = String(opens);
    if (opens) this.closer.focus();
    else if (isFocused) caption?.focus();
  }
}
