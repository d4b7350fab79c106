import { type PackedSplats, type PackRanges } from "../scene/packed_splats.js";
import type { Shifts } from "../container/compensation.js";
import type { SceneInfo } from "../container/root.js";
/** Where a picture is taken from: x_camera = R·x + t in the space of the means, x right, y down, z forward. */
export interface View {
    /** R, row by row. */
    readonly rotation: readonly number[];
    readonly translation: readonly number[];
    /** Focal lengths, px of the canvas. */
    readonly focal: readonly [number, number];
}
/** Draws packed splats with WebGL 2, by the rules of SPEC 8.7. */
export declare class SplatRenderer {
    private readonly canvas;
    private readonly scene;
    private readonly degree;
    private readonly gl;
    private readonly program;
    private readonly textures;
    private readonly means;
    private readonly ranges;
    private rows;
    /** Direction of view of the last sort; undefined where rows have come since. */
    private sortedFor;
    /**
     * @param canvas - Where pictures are drawn.
     * @param scene - What the root says; textures are made for all of its splats.
     * @param degree - SH degree that is drawn.
     */
    constructor(canvas: HTMLCanvasElement, scene: SceneInfo, degree: number, ranges?: Partial<PackRanges>);
    /** Put a chunk's rows where they belong; `shifts` are those of compensation. */
    write(packed: PackedSplats, firstRow: number, shifts?: Shifts): void;
    /** Draw a picture. */
    draw(view: View): void;
    /** Give back what the graphics memory holds. */
    delete(): void;
    private sort;
}
