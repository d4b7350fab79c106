import type { ByteRange } from "../container/scene_index.js";
import { SourceError } from "../errors.js";
import type { Answer, ByteSource, ReadOptions } from "../loader/byte_source.js";

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
      readonly programs: readonly [string, string, string];
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

  async read({ offset, length }: ByteRange, { signal }: ReadOptions = {}): Promise<Answer> {
    signal?.throwIfAborted();
    const id = this.nextId++;
    // A kernel that computes answers late, one that has ended never.
    let onAbort = (): void => undefined;
    const answered = new Promise<Uint8Array>((resolve, reject) => {
      onAbort = () => reject(signal!.reason as Error);
      signal?.addEventListener("abort", onAbort, { once: true });
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
    try {
      return { offset, total: this.length, whole: false, parts: once(await answered) };
    } finally {
      signal?.removeEventListener("abort", onAbort);
      this.waiting.delete(id);
    }
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
