import type { SceneInfo } from "../container/root.js";
import type { View } from "./renderer.js";
import type { ViewerPose } from "./viewer_handle.js";
export type Vector = [number, number, number];
/** Right, down and forward of a camera in the space of the means. */
export type Axes = [Vector, Vector, Vector];
/** A camera that turns around a point, walks up to it and moves with it, or flies. */
export declare class OrbitCamera {
    private axes;
    private target;
    private distance;
    private readonly down;
    private focal;
    private picture;
    /** Start at the scene's first view, or in front of its box. */
    constructor(scene: Pick<SceneInfo, "axes" | "box" | "firstView">);
    /** Where the camera is, in the space of the means. */
    get position(): Vector;
    /** The direction of view. */
    get forward(): Vector;
    /** Look from somewhere; what is turned around stays as far away as it was. */
    place(view: ViewerPose): void;
    /** Look at a ball from where it fills most of the picture, from the side that the axes call the front. */
    frame(centre: Vector, radius: number): void;
    /** Turn around what is so far in front of the camera; the picture stays as it is. */
    turnAround(distance: number): void;
    /** Turn around the target by a movement of the pointer, px. */
    turn(dx: number, dy: number): void;
    /** Look around from where the camera is, by a movement of the pointer, px. */
    look(dx: number, dy: number): void;
    /** Move sideways by a movement of the pointer, px of a picture of some height. */
    move(dx: number, dy: number, height: number): void;
    /** Fly right, down and forward, in shares of the distance to the target. */
    fly(right: number, down: number, forward: number): void;
    /** Come nearer, by a factor. */
    zoom(factor: number): void;
    /** The view for a canvas; nothing of the picture is cut off where its width is known. */
    view(height: number, width?: number): View;
}
