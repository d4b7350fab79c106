import type { PlyRequest, PlyResponse } from "./ply_messages.js";
type Post = (response: PlyResponse, transfer: ArrayBuffer[]) => void;
/** Read a PLY of 3DGS training as its bytes come, and post it in packed rows. */
export declare function readPly(request: PlyRequest, post: Post): Promise<void>;
export {};
