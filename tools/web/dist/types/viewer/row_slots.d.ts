/** Rows beside each other. */
export interface RowRun {
    readonly first: number;
    readonly count: number;
}
/** Rows of a layer that is smaller than its scene: chunks take them and give them back. */
export declare class RowSlots {
    /** Rows that nobody has, ascending, no two runs beside each other. */
    private free;
    constructor(rows: number);
    /**
     * Take rows, the first that are free, in as many runs as it needs.
     *
     * @throws RangeError where there are fewer.
     */
    take(count: number): RowRun[];
    /** Give rows back. */
    give(runs: readonly RowRun[]): void;
}
