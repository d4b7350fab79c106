/** Rows in the order in which they are drawn. */
export interface DepthOrder {
  /** The rows that were sorted, from the farthest to the nearest, with room behind them. */
  readonly order: Uint32Array;
  readonly rows: number;
  /** How long it took, ms. */
  readonly milliseconds: number;
}

/** What a sorting worker is told. */
export type SortRequest =
  | { readonly type: "allocate"; readonly rows: number }
  | { readonly type: "rows"; readonly firstRow: number; readonly words: Uint32Array }
  | {
      readonly type: "sort";
      readonly rows: number;
      readonly forward: readonly number[];
      readonly spare: Uint32Array | undefined;
    };

/** What it answers to `sort`; the order is handed over. */
export type SortResponse = DepthOrder;
