import type { PlyScene } from "./ply_messages.js";
/** Most bytes of a header: one of 3DGS at SH degree 3 has about 1,500. */
export declare const MOST_HEADER_BYTES = 65536;
/** Where the values of a splat are in the PLY of 3DGS training. */
export interface PlyLayout {
    readonly scene: Omit<PlyScene, "origin" | "fileOrigin">;
    /** The origin that the file states; its means are relative to it. */
    readonly origin: readonly number[];
    /** Bytes of the header and of a row. */
    readonly headerBytes: number;
    readonly stride: number;
    /** Byte of a row where each value is: means, scales, quats, opacity, sh0, then bands coefficient by coefficient. */
    readonly columns: readonly number[];
}
/**
 * Read the header of a PLY.
 *
 * @param bytes - The beginning of the file.
 * @returns undefined where the header does not end in `bytes`.
 * @throws Error with a sentence for a person where the file is no PLY of splats, or of a kind that is not read.
 */
export declare function readPlyHeader(bytes: Uint8Array): PlyLayout | undefined;
