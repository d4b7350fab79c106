import type { ViewTable } from "../container/view_table.js";
import { type Boxes } from "./boxes.js";
import { type Pose, type WeightedPose } from "./poses.js";
/** How much more than usual a pose shows of each chunk (docs/streaming.md, 3 to 6). */
export type PoseRatios = (pose: Pose) => Float64Array;
/** The sum of a path's ratios, each times its weight, from the first pose on. */
export declare function along(ratios: PoseRatios, path: readonly WeightedPose[]): Float64Array;
/** Ratios by boxes alone: contribution over the square of the depth, where they show. */
export declare function byBoxes(boxes: Boxes, contribution: Float64Array): PoseRatios;
/** Ratios by what the viewpoints near a pose show (docs/streaming.md, 4). */
export declare function byViewTable(table: ViewTable, boxes: Boxes, contribution: Float64Array): PoseRatios;
/** SGSS' priorities in the place of ratios; 0 for what its test finds not visible. */
export declare function bySgss(boxes: Boxes, splats: ArrayLike<number>): PoseRatios;
/** As how many splats each chunk counts when a picture is compensated (docs/streaming.md, 10). */
export declare function countedSplats(splats: ArrayLike<number>, ratios: Float64Array): number[];
