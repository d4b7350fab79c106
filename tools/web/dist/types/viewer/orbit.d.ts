import type { SceneInfo } from "../container/root.js";
import type { View } from "./renderer.js";
import type { ViewerPose } from "./viewer_handle.js";
/** A camera that turns around a point, walks up to it and moves with it. */
export declare class OrbitCamera {
    /** World to camera: rows right, down, forward. */
    private axes;
    private target;
    private distance;
    private readonly down;
    /** Focal lengths over the height of the picture. */
    private focal;
    /** Start at the scene's first view, or in front of its box. */
    constructor(scene: SceneInfo);
    /** Look from somewhere; what is turned around stays as far away as it was. */
    place(view: ViewerPose): void;
    /** Turn by a movement of the pointer, px. */
    turn(dx: number, dy: number): void;
    /** Move sideways by a movement of the pointer, px of a picture of some height. */
    move(dx: number, dy: number, height: number): void;
    /** Come nearer, by a factor. */
    zoom(factor: number): void;
    /** The view for a canvas. */
    view(height: number): View;
}
