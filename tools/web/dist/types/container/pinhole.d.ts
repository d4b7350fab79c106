import type { Fields } from "./fields.js";
/** A pinhole camera as SPEC 4.4 has it: world to camera, x right, y down, z forward. */
export interface Pinhole {
    /** px */
    readonly width: number;
    /** px */
    readonly height: number;
    /** Focal lengths and principal point, px. */
    readonly fx: number;
    readonly fy: number;
    readonly cx: number;
    readonly cy: number;
    /** R, row by row. */
    readonly rotation: readonly number[];
    /** t of x_camera = R·x + t, scene units. */
    readonly translation: readonly number[];
}
/** Read the root's `first_view`. */
export declare function readFirstView(fields: Fields): Pinhole;
/** Whether nine numbers, row by row, are a rotation within the tolerance of SPEC 4.4. */
export declare function isRotation(r: readonly number[]): boolean;
