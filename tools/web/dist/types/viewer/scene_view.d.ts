import type { LevelEntry } from "../container/root.js";
import type { ByteSource } from "../loader/byte_source.js";
import { type FetchOrder } from "./cogs_feed.js";
import { Controls } from "./controls.js";
import { Meter } from "./meter.js";
import { type PictureOptions } from "./renderer.js";
import type { Prefix } from "./scene_feed.js";
import type { ViewerPose, ViewerStatistics } from "./viewer_handle.js";
import { type ViewerWorkers } from "./viewer_workers.js";
/** A URL, a file that the page has, or another source of the bytes of a `.cogs` file. */
export type SceneSource = string | Blob | ByteSource;
/** What is told of a scene view. */
export interface SceneViewHost {
    /** The statistics changed, or what the canvas shows. */
    changed(): void;
    /** Something went wrong with a scene, with the one that is compared with or with the graphics. */
    failed(error: unknown, which: "scene" | "other" | "graphics"): void;
    /** The graphics are back. */
    restored(): void;
}
/** Shows a scene on a canvas, and beside it a second one: loads, moves, draws on demand. */
export declare class SceneView {
    private readonly canvas;
    private readonly host;
    private readonly workers;
    readonly controls: Controls;
    readonly meter: Meter;
    statistics: ViewerStatistics;
    /** Highest SH degree of the scene. */
    degree: number;
    /** Device pixels for a CSS pixel, at most. */
    mostPixelRatio: number;
    /** Device pixels for a CSS pixel, instead of those of the screen. */
    pixelRatio: number | undefined;
    /** Levels of the scene, the coarsest first; none where it has none. */
    levels: readonly LevelEntry[];
    /** Whether slow graphics draw moving and growing pictures in fewer pixels. */
    mayHaste: boolean;
    /** What is fetched first of scenes to come. */
    order: FetchOrder;
    private readonly renderer;
    private readonly pace;
    private readonly abort;
    private readonly observer;
    private main;
    private other;
    private camera;
    /** Where the zero of poses is in the world. */
    private origin;
    /** The pose at the start, for `reset`. */
    private home;
    private homeCamera;
    private pose;
    private touched;
    /** Counts what was shown, so that a scene that was replaced before it began does not begin. */
    private readonly runs;
    private scheduled;
    private dirty;
    private lost;
    private lastFrame;
    private lastChange;
    /** Whether the last picture has all pixels, and shows all that had come. */
    private isSharp;
    private isWhole;
    private budget;
    /** Whether all that the first view was worth has come: from then on holes are not filled, and nothing is waited for. */
    private wasSettled;
    /** Where was looked from last. */
    private looked;
    private readonly waiting;
    private picture;
    private fills;
    private chosenLevel;
    /** Level of the second scene that was drawn last. */
    private otherLevel;
    /** @throws NoWebGlError where the browser has no WebGL 2. */
    constructor(canvas: HTMLCanvasElement, host: SceneViewHost, workers: ViewerWorkers | undefined);
    /** Whether something of the scene is on the canvas. */
    get isShown(): boolean;
    /** Whether a second scene is compared with. */
    get compares(): boolean;
    /** Rows that the last picture was made of. */
    get drawnRows(): number;
    get fillHoles(): boolean;
    set fillHoles(fills: boolean);
    /** The level that is drawn, 0 the coarsest, or a place between two; undefined for that of the picture's size (SPEC 8.11). */
    get level(): number | undefined;
    set level(level: number | undefined);
    /** Look from somewhere, until a person moves; it holds for scenes to come as well. */
    get view(): ViewerPose | undefined;
    set view(view: ViewerPose | undefined);
    /** Change what pictures show. */
    show(options: Partial<Omit<PictureOptions, "fill">>): void;
    /** Draw at most so many splats of a scene, the first of its file; where they are chosen by the view, those that it is worth most to. */
    limit(splats: number): void;
    /** Show a scene in the place of what is shown. */
    load(source: SceneSource): Promise<void>;
    /** Show a second scene left of the divide; undefined ends that. */
    compare(source: SceneSource | undefined): Promise<void>;
    /** Go back to the first view. */
    reset(): void;
    /** Parts of the file that can be shown alone. */
    prefixes(count: number): Prefix[];
    /** Show the scene as it is after a part of its file; undefined shows all that has come. */
    showPrefix(prefix: Prefix | undefined): void;
    /** Resolves when the canvas shows all that has arrived, in the view asked for. */
    settled(): Promise<void>;
    /** Draw a picture with the next frame of the browser. */
    readonly redraw: () => void;
    /** End loading, workers and drawing, and give the memory back. */
    dispose(): void;
    private get layers();
    private run;
    private mainHost;
    private otherHost;
    private layerOf;
    private progressed;
    private note;
    private close;
    /** Have `frame` called with the next frame of the browser, or after some time. */
    private schedule;
    private readonly frame;
    /** Tell the scenes where is looked from, where that has changed. */
    private look;
    /** Have the scenes draw the levels for the size of the picture, or the one that was chosen. */
    private drawLevels;
    /** Width and height of pictures, px, of which a share is drawn. */
    private size;
    /** Whether programs are built; where they are not yet, it is looked again soon. */
    private canDraw;
    /** Whether the graphics would still work on a picture when the rest of the scene is there. */
    private restComesSoon;
    /** Draw what has come; returns whether that is all, in the view asked for. */
    private draw;
}
