import type { SceneIndex } from "../container/scene_index.js";
import type { Unit } from "../schedule/scheduler.js";
/** What is taken from an index. */
export type UnitIndex = Pick<SceneIndex, "segments" | "chunks" | "range" | "codebookSegmentsOf">;
/** A unit, and the segment that it is. */
export interface SegmentUnit extends Unit {
    readonly segment: number;
}
/**
 * The segments that a visitor's pictures need as units of the scheduler (docs/streaming.md, 7), in the order of the file.
 *
 * Chunks that end (SPEC 5.10) are left out, as where chunks are not drawn in the order of the file (SPEC 8.6).
 *
 * @param index - As far as it was read; units that are known stay what they are when more is read.
 * @param degree - Highest SH degree that is wanted.
 * @param compensates - Whether the layers of compensation are wanted.
 */
export declare function segmentUnits(index: UnitIndex, degree: number, compensates: boolean): SegmentUnit[];
/** The units of each chunk. */
export declare function unitsByChunk(units: readonly SegmentUnit[], chunks: number): number[][];
