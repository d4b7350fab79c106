import type { ByteRange } from "../container/scene_index.js";
import type { Answer, ByteSource } from "../loader/byte_source.js";
/** What a widget of anywidget has of its model: messages to Python and back. */
export interface WidgetModel {
    send(content: object): void;
    on(name: "msg:custom", act: (content: WidgetAnswer, buffers: DataView[]) => void): void;
    off(name: "msg:custom", act: (content: WidgetAnswer, buffers: DataView[]) => void): void;
}
/** What Python answers (`tools/delivery/notebook.py`). */
export type WidgetAnswer = {
    readonly type: "scene";
    readonly name: string;
    readonly length: number;
    readonly programs: readonly [string, string];
} | {
    readonly type: "bytes";
    readonly id: number;
} | {
    readonly type: "failed";
    readonly id: number;
    readonly message: string;
};
/** A file that Python holds: its bytes come in messages. */
export declare class WidgetSource implements ByteSource {
    private readonly model;
    private readonly length;
    private readonly waiting;
    private nextId;
    constructor(model: WidgetModel, length: number);
    read({ offset, length }: ByteRange): Promise<Answer>;
    close(): void;
    private readonly answered;
}
/**
 * Show the scene of a notebook's widget; anywidget calls this.
 *
 * @returns What ends it.
 */
export declare function render({ model, el }: {
    readonly model: WidgetModel;
    readonly el: HTMLElement;
}): () => void;
