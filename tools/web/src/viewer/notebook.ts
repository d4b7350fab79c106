import type { ByteRange } from "../container/scene_index.js";
import { SourceError } from "../errors.js";
import type { Answer, ByteSource } from "../loader/byte_source.js";
import { type CogsplatViewer, defineViewer } from "./element.js";
import { workersOfTexts } from "./viewer_workers.js";

/** Part of anywidget's model that is used: messages to Python and back. */
export interface WidgetModel {
  send(content: object): void;
  on(name: "msg:custom", act: (content: WidgetAnswer, buffers: DataView[]) => void): void;
  off(name: "msg:custom", act: (content: WidgetAnswer, buffers: DataView[]) => void): void;
}

/** Answers of Python (`tools/delivery/notebook.py`). */
export type WidgetAnswer =
  | {
      readonly type: "scene";
      readonly name: string;
      readonly length: number;
      readonly programs: readonly [string, string];
    }
  | { readonly type: "bytes"; readonly id: number }
  | { readonly type: "failed"; readonly id: number; readonly message: string };

/** A file in the Python kernel, whose bytes arrive in messages. */
export class WidgetSource implements ByteSource {
  private readonly waiting = new Map<number, (answer: WidgetAnswer, buffers: DataView[]) => void>();
  private nextId = 0;

  constructor(
    private readonly model: WidgetModel,
    private readonly length: number,
  ) {
    model.on("msg:custom", this.answered);
  }

  async read({ offset, length }: ByteRange): Promise<Answer> {
    const id = this.nextId++;
    const part = await new Promise<Uint8Array>((resolve, reject) => {
      this.waiting.set(id, (answer, [buffer]) => {
        if (answer.type === "failed" || buffer === undefined) {
          reject(
            new SourceError(
              `Python could not read the file: ${answer.type === "failed" ? answer.message : "no bytes arrived"}`,
              0,
            ),
          );
        } else resolve(new Uint8Array(buffer.buffer, buffer.byteOffset, buffer.byteLength));
      });
      this.model.send({ type: "read", id, offset, length });
    });
    return { offset, total: this.length, whole: false, parts: once(part) };
  }

  close(): void {
    this.model.off("msg:custom", this.answered);
  }

  private readonly answered = (answer: WidgetAnswer, buffers: DataView[]): void => {
    if (answer.type === "scene") return;
    this.waiting.get(answer.id)?.(answer, buffers);
    this.waiting.delete(answer.id);
  };
}

async function* once(part: Uint8Array): AsyncGenerator<Uint8Array> {
  yield part;
}

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
    (customElements.get("cogsplat-viewer") as typeof CogsplatViewer).workers = workersOfTexts(...answer.programs);
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
