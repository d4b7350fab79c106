import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";
/** A PLY to read: where it is, how many of its rows are wanted and how they are packed. */
export interface PlyRequest {
    readonly type: "ply";
    readonly source: Blob | string;
    readonly mostRows: number;
    readonly ranges: PackRanges;
    /** Most bits a second that come, Infinity as fast as they can. */
    readonly bitsPerSecond: number;
}
/** A change of the rate while a PLY is read. */
export interface RateRequest {
    readonly type: "rate";
    readonly bitsPerSecond: number;
}
/** What the header says of a scene. */
export interface PlyScene {
    readonly splats: number;
    readonly shDegree: number;
    /** Where the zero of the packed means is in the world, scene units. */
    readonly origin: readonly number[];
    /** Where the zero of the file's means is. */
    readonly fileOrigin: readonly number[];
    readonly axes: string;
    readonly linear: boolean;
    readonly kernelPx: number;
    readonly antialiased: boolean;
}
/** What comes of it, in this order: the header, rows, and the end or why there is none. */
export type PlyResponse = {
    readonly type: "scene";
    readonly scene: PlyScene;
    readonly totalBytes: number | undefined;
} | {
    readonly type: "rows";
    readonly firstRow: number;
    readonly packed: PackedSplats;
    readonly bytes: number;
} | {
    readonly type: "end";
    readonly bytes: number;
} | {
    readonly type: "failed";
    readonly status: number | undefined;
    readonly message: string;
};
