import type { ViewPlane } from "./depth_order.js";

/** Rows in drawing order. */
export interface DepthOrder {
  /** Rows from the farthest to the nearest; the array may be longer than `rows`. */
  readonly order: Uint32Array;
  readonly rows: number;
  /** Duration of the sort, ms. */
  readonly milliseconds: number;
}

/** Message to a sorting worker. */
export type SortRequest =
  | { readonly type: "allocate"; readonly rows: number }
  | { readonly type: "rows"; readonly firstRow: number; readonly means: Float32Array }
  | {
      readonly type: "sort";
      readonly rows: number;
      readonly plane: ViewPlane;
      readonly spare: Uint32Array | undefined;
    };

/** Answer to `sort`; the order is transferred. */
export type SortResponse = DepthOrder;
