import type { LevelEntry } from "../container/root.js";
import type { SceneView } from "./scene_view.js";
import type { ViewerStatistics } from "./viewer_handle.js";
/** What the panel asks of the viewer beside its scene view. */
export interface PanelHost {
    reload(): void;
    chooseOther(): void;
}
/** The settings: a form whose fields act at once. */
export declare class Panel {
    private readonly form;
    private readonly view;
    private readonly fields;
    private readonly table;
    constructor(form: HTMLFormElement, view: SceneView, host: PanelHost, signal: AbortSignal);
    /** Set the field of the background to a colour that was given otherwise. */
    set background(colour: string);
    /** Offer the SH degrees of a scene. */
    offerDegrees(most: number, chosen: number): void;
    /** Offer the levels of a scene, where it has any. */
    offerLevels(levels: readonly LevelEntry[], chosen: number | undefined): void;
    /** Write the statistics, where they are shown. */
    update(statistics: ViewerStatistics, canvas: HTMLCanvasElement): void;
    private get customRow();
    private field;
    private changed;
}
