import type { SplatLayer } from "./splat_layer.js";
/** Where a picture is taken from: x_camera = R·x + t in the space of the means, x right, y down, z forward. */
export interface View {
    /** R, row by row. */
    readonly rotation: readonly number[];
    readonly translation: readonly number[];
    /** Focal lengths, px of the canvas. */
    readonly focal: readonly [number, number];
}
/** What a picture shows beside the view. */
export interface PictureOptions {
    /** Colour behind the splats: R, G, B and opacity from 0 to 1, display-encoded. */
    readonly background: readonly [number, number, number, number];
    /** Highest SH degree that is drawn. */
    readonly degree: number;
    /** How much holes between splats take the colour around them, 0 to 1. */
    readonly fill: number;
    /** Where the second scene ends, as a share of the width from the left. */
    readonly divide: number;
}
/** Draws packed splats with WebGL 2, by the rules of SPEC 8.7. */
export declare class SplatRenderer {
    private readonly canvas;
    readonly gl: WebGL2RenderingContext;
    private splats;
    private composite;
    private target;
    /** @throws NoWebGlError where the browser has no WebGL 2. */
    constructor(canvas: HTMLCanvasElement);
    /**
     * Whether its programs are built, which browsers do beside the page where they can.
     *
     * @throws NoWebGlError where they cannot be built.
     */
    get isReady(): boolean;
    /** Make programs and buffers anew, because the graphics memory was lost. */
    restore(): void;
    /** Set the size of pictures, px. */
    resize(width: number, height: number): void;
    /**
     * Draw a picture.
     *
     * @param view - The translation is relative to its origin in the world, that of the scene that poses are given for.
     * @param layers - The scene, and where there are two, the one that is shown left of the divide.
     * @returns Whether the picture holds all rows that have come.
     */
    draw(view: View & {
        readonly origin: readonly number[];
    }, layers: readonly SplatLayer[], options: PictureOptions): boolean;
    /** Give back what the graphics memory holds. */
    close(): void;
    private drawLayer;
    private build;
}
/** A browser, or a machine, without WebGL 2. */
export declare class NoWebGlError extends Error {
    readonly name = "NoWebGlError";
}
