import type { SceneView } from "./scene_view.js";
/** Pictures of a scene after growing parts of its file; each can be chosen to be looked at. */
export declare class FilmStrip {
    private readonly strip;
    private readonly canvas;
    private readonly view;
    /** Counts strips, so that one that was replaced stops. */
    private run;
    constructor(strip: HTMLElement, canvas: HTMLCanvasElement, view: SceneView);
    get isOpen(): boolean;
    /** Take the pictures, in the present view, and show them. */
    open(): Promise<void>;
    /** Take the strip away, and show the whole scene. */
    close(): void;
    private frame;
    private choose;
}
