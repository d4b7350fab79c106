import { type PackedSplats } from "../scene/packed_splats.js";
import type { Vector } from "./orbit.js";
/** Where the bulk of some splats is. */
export interface Bulk {
    readonly centre: Vector;
    /** Radius of the ball around the bulk, scene units. */
    readonly radius: number;
}
/**
 * What of some splats a picture is to show: an object as a whole, of all else where most of it is.
 *
 * @param zero - Where the zero of the result is, in the space of the packed means.
 */
export declare function bulkOf(packed: PackedSplats, zero: Vector): Bulk | undefined;
/**
 * How far in front of a camera the splats in the middle of its picture are: what turning goes around.
 *
 * @param zero - Where the zero of the camera's space is, in the space of the packed means.
 * @param position - Of the camera.
 * @param forward - Direction of view, of unit length.
 */
export declare function depthAhead(packed: PackedSplats, zero: Vector, position: Vector, forward: Vector): number | undefined;
