import type { Shifts } from "../container/compensation.js";
import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";
import type { DepthSorter } from "./depth_sorter.js";
/** What a scene is drawn by. */
export interface LayerScene {
    /** Splats of the scene. */
    readonly splats: number;
    readonly shDegree: number;
    /** Where the means' zero is in the world, scene units. */
    readonly origin: readonly number[];
    readonly linear: boolean;
    /** Variance that is added to projected covariances, px². */
    readonly kernelPx: number;
    readonly antialiased: boolean;
    /** Whether opacities differ between levels (SPEC 5.11). */
    readonly hasLevels: boolean;
}
/** One scene that is drawn: its rows, and their order for the view. */
export declare class SplatLayer {
    private readonly gl;
    readonly scene: LayerScene;
    readonly ranges: PackRanges;
    private readonly changed;
    /** Rows that memory was taken for. */
    readonly capacity: number;
    private readonly textures;
    /** Rows from the first on that have come. */
    private arrived;
    /** Whether compensation adds something to a row. */
    compensated: boolean;
    /** Share of the finer one of the two levels whose opacities are mixed. */
    between: number;
    /** Duration of the last sort, ms. */
    sortMilliseconds: number;
    private most;
    private sorted;
    private sorting;
    private stale;
    private spare;
    /** Direction of the last view. */
    private forward;
    private closed;
    /**
     * @param ranges - What the codes of packed rows stand for.
     * @param capacity - Most rows that are held.
     * @param makeSorter - Makes what sorts so many rows.
     * @param changed - Called when there is something new to draw.
     */
    constructor(gl: WebGL2RenderingContext, scene: LayerScene, ranges: PackRanges, capacity: number, makeSorter: (rows: number) => DepthSorter, changed: () => void);
    private readonly sorter;
    /** Rows that are drawn as soon as they are sorted. */
    get rows(): number;
    /** Rows that the last picture was made of. */
    get drawnRows(): number;
    /** Whether an order is being made that shows more than the last one. */
    get isSorting(): boolean;
    /** Put a chunk's rows where they belong. */
    write(packed: PackedSplats, firstRow: number): void;
    /** Draw rows no longer. */
    clear(firstRow: number, count: number): void;
    /** Replace rows whose means stay what they are, so that their order does. */
    repaint(packed: PackedSplats, firstRow: number): void;
    /** Note the opacities of rows at two adjacent levels, as `LevelOpacities` gives them. */
    writeLevels(words: Uint32Array, firstRow: number): void;
    /** Note what compensation adds to rows. */
    shift(firstRow: number, count: number, shifts: Shifts | undefined): void;
    /** Draw only the first rows. */
    limit(rows: number): void;
    /** Make the textures anew, because the graphics memory was lost. */
    restore(): void;
    /** Upload a part of what has changed; returns whether that was all. */
    upload(): boolean;
    /**
     * Bind what is drawn, and have the rows sorted where they are not sorted for a view.
     *
     * @param forward - Direction of view.
     * @returns Whether all rows that have come are bound, in the order for the view.
     */
    prepare(forward: readonly number[]): boolean;
    close(): void;
    private sort;
}
