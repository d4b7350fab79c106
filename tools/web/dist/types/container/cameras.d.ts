import { type Pinhole } from "./pinhole.js";
/** A camera that the scene was made from or encoded for. */
export interface Camera extends Pinhole {
    readonly name: string;
}
/** Read a segment of cameras (SPEC 5.8). */
export declare function readCameras(payload: Uint8Array): Camera[];
