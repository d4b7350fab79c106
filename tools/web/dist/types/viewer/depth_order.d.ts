/**
 * Rows from the farthest to the nearest, by a radix sort of their depths as float32; rows at one depth stay in order.
 *
 * @param means - Three a row.
 * @param rows - Rows to sort.
 * @param forward - Direction of view.
 * @param order - Receives the rows.
 */
export declare function sortByDepth(means: Float32Array, rows: number, forward: readonly number[], order: Uint32Array): void;
/** The same in steps of about a millisecond, between which other work can be done. */
export declare function sortSteps(means: Float32Array, rows: number, forward: readonly number[], order: Uint32Array): Generator<void>;
