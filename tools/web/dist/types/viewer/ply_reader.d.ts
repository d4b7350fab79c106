import type { Meter } from "./meter.js";
import type { PlyRequest, PlyResponse } from "./ply_messages.js";
type Post = (response: PlyResponse, transfer: ArrayBuffer[]) => void;
/**
 * Read a PLY of 3DGS training as its bytes come, and post it in packed rows.
 *
 * @param meter - Its bytes come no faster than the meter's rate.
 * @param rest - Awaited between two blocks of rows.
 */
export declare function readPly(request: PlyRequest, meter: Meter, post: Post, rest?: () => Promise<void>): Promise<void>;
export {};
