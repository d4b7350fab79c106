import { type CogsplatViewer, defineViewer } from "./element.js";
import { extrasOfText } from "./extras_text.js";
import { workersOfTexts } from "./viewer_workers.js";
import { type WidgetAnswer, type WidgetModel, WidgetSource } from "./widget_source.js";

/**
 * Show the scene of a notebook's widget, called by anywidget.
 *
 * @returns Function that ends it.
 */
export function render({ model, el }: { readonly model: WidgetModel; readonly el: HTMLElement }): () => void {
  defineViewer();
  const element = document.createElement("cogsplat-viewer");
  // Full width of the cell, at most the window's height.
  Object.assign(element.style, { width: "100%", maxHeight: "80vh", borderRadius: "8px" });
  let source: WidgetSource | undefined;
  const opened = (answer: WidgetAnswer): void => {
    if (answer.type !== "scene" || source !== undefined) return;
    // Another copy of this program may have defined the element before.
    const viewer = customElements.get("cogsplat-viewer") as typeof CogsplatViewer;
    const [decoder, sorter, extras] = answer.programs;
    viewer.workers = workersOfTexts(decoder, sorter);
    viewer.loadExtras = () => extrasOfText(extras);
    source = new WidgetSource(model, answer.length);
    element.setAttribute("label", answer.name);
    el.append(element);
    void element.load(source);
  };
  model.on("msg:custom", opened);
  model.send({ type: "open" });
  return () => {
    model.off("msg:custom", opened);
    source?.close();
    element.remove();
  };
}
