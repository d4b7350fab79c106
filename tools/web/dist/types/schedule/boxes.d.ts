import type { Pose } from "./poses.js";
/** Boxes of chunks: six numbers each, minimum then maximum corner. */
export type Boxes = ArrayLike<number>;
/** The share of the picture that the rectangle around a box takes; 0 behind the eye or beside the picture. */
export declare function pictureShare(boxes: Boxes, box: number, pose: Pose): number;
/** How deep the middle of a box lies, scene units. */
export declare function middleDepth(boxes: Boxes, box: number, pose: Pose): number;
/** Whether SGSS' test finds a box visible: it meets the pyramid of view in the planes of the pose's axes. */
export declare function inPyramid(boxes: Boxes, box: number, pose: Pose): boolean;
