import type { Kernels } from "../kernels/kernels.js";
import { type StreamRecord } from "./records.js";
/** Floats between two rows of the basis in the kernels' memory: 45, padded to whole vectors. */
export declare const BASIS_STRIDE = 48;
/** What a basis stream of shN states of itself. */
export interface ShnBasisParams {
    readonly step: number;
    readonly shrink: number;
    readonly width: number;
    /** For each group the bytes of its inner codes, then of its last codes. */
    readonly sizes: readonly (readonly [number, number])[];
}
/** The coordinates of shN on its basis, as a kernel sums them. */
export interface ShnCoordinates {
    /** Addresses: rows in the order of falling ends, rows of each end, and a table of columns of coordinates. */
    readonly order: number;
    readonly counts: number;
    readonly columns: number;
    readonly width: number;
}
/** Check how many bytes of parameters a basis stream of shN has, and read which codebook it names (SPEC 6.14). */
export declare function readShnCodebook({ params }: StreamRecord): number;
/**
 * Read what else the parameters of a basis stream of shN say (SPEC 6.14).
 *
 * @param bookRows - Rows of the codebook that the stream names.
 */
export declare function readShnParams({ params }: StreamRecord, bookRows: number): ShnBasisParams;
/**
 * Read the coordinates of every row (SPEC 6.14).
 *
 * Coordinate j of the rows in the order of falling ends is one column: first the inner codes of the rows that end
 * behind j + 1, then the last codes of those that end there.
 */
export declare function readShnCoordinates(k: Kernels, stream: StreamRecord, params: ShnBasisParams): ShnCoordinates;
/** Refuse entries of a basis that are too large (SPEC 6.14). */
export declare function checkBasisEntries(entries: Float32Array): void;
