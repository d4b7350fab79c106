import type { Viewpoint } from "../container/root.js";
import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";

/** A PLY to read: source, number of rows, and packing. */
export interface PlyRequest {
  readonly type: "ply";
  readonly source: Blob | string;
  readonly mostRows: number;
  readonly ranges: PackRanges;
  /** Maximum bandwidth, bit/s. */
  readonly bitsPerSecond: number;
}

/** A change of the rate while a PLY is read. */
export interface RateRequest {
  readonly type: "rate";
  readonly bitsPerSecond: number;
}

/** Scene information of the header. */
export interface PlyScene {
  readonly splats: number;
  readonly shDegree: number;
  /** World position of the means' zero, scene units. */
  readonly origin: readonly number[];
  readonly axes: string;
  readonly linear: boolean;
  readonly kernelPx: number;
  readonly antialiased: boolean;
  /** Viewpoints of the training pictures, in the space of the means; may be empty. */
  readonly capture: readonly Viewpoint[];
}

/** Messages of the reader, in this order: header, rows, and the end or an error. */
export type PlyResponse =
  | { readonly type: "scene"; readonly scene: PlyScene; readonly totalBytes: number | undefined }
  | { readonly type: "rows"; readonly firstRow: number; readonly packed: PackedSplats; readonly bytes: number }
  | { readonly type: "end"; readonly bytes: number }
  | { readonly type: "failed"; readonly status: number | undefined; readonly message: string };
