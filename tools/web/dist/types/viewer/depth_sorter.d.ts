import type { ViewerWorkers } from "./viewer_workers.js";
/** Rows in the order in which they are drawn. */
export interface DepthOrder {
    /** The rows that were sorted, from the farthest to the nearest, with room behind them. */
    readonly order: Uint32Array;
    readonly rows: number;
    /** How long it took, ms. */
    readonly milliseconds: number;
}
/** Sorts the rows of one scene by depth, in a worker; without workers where it is called, in slices. */
export declare class DepthSorter {
    private readonly worker;
    private readonly local;
    private answer;
    /**
     * @param rows - Rows of the scene.
     * @param workers - Makes the worker; undefined sorts on the caller's thread.
     * @param failed - Told where the worker cannot be started.
     */
    constructor(rows: number, workers: ViewerWorkers | undefined, failed: (message: string) => void);
    /** Take the packed words of rows, which are handed over and no longer the caller's. */
    add(firstRow: number, words: Uint32Array): void;
    /**
     * Sort the first rows. One order is made at a time.
     *
     * @param forward - Direction of view.
     * @param spare - An order that is no longer used; its memory is used again.
     */
    sort(rows: number, forward: readonly number[], spare: Uint32Array | undefined): Promise<DepthOrder>;
    close(): void;
    private send;
}
/** The means of a scene, and their order. */
export declare class RowSorter {
    private readonly rows;
    private readonly means;
    constructor(rows: number);
    add(firstRow: number, words: Uint32Array): void;
    sort(rows: number, forward: readonly number[], spare: Uint32Array | undefined): DepthOrder;
    /** Sort, and let the page do other things meanwhile. */
    sortInSlices(rows: number, forward: readonly number[], spare: Uint32Array | undefined): Promise<DepthOrder>;
}
