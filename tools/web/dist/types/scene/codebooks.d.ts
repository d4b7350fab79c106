import type { CodebookEntry } from "../container/root.js";
import type { Kernels } from "../kernels/kernels.js";
import { Payload, type StreamRecord } from "../streams/records.js";
/** Values of a row in each SH band, coefficients times channels. */
export declare const BAND_FLOATS: readonly [9, 15, 21];
/** Rows of a shape codebook: three columns of scales, four of quaternions. */
export interface ShapeCodebook {
    readonly rows: number;
    readonly scales: readonly number[];
    readonly quats: readonly number[];
}
/** Rows of a colour codebook: for each band there is, the address of its rows. */
export interface ColourCodebook {
    readonly rows: number;
    readonly bands: (number | undefined)[];
}
/** The codebooks of a scene, as far as they have come (SPEC 5.5, 7.1). They stay in the kernels' memory. */
export declare class Codebooks {
    private readonly k;
    private readonly entries;
    private readonly shapes;
    private readonly colours;
    constructor(k: Kernels, entries: readonly CodebookEntry[]);
    /**
     * Decode a codebook's segment and keep its rows. Nothing else may be reserved while it runs.
     *
     * @param kind - Kind of the segment: 3, or 4 to 6 for the bands.
     */
    add(codebook: number, kind: number, payload: Uint8Array): void;
    /** The shape codebook that a stream names; it must be one that its segment needs. */
    shape(codebook: number, needs: number): ShapeCodebook;
    /** The colour codebook that a stream names; it must be one that its segment needs. */
    colour(codebook: number, needs: number, degree: number): ColourCodebook;
    private check;
    private there;
}
/**
 * Scales and quaternions of a codebook or of escape rows: seven columns.
 *
 * @param escapes - Number of escape rows; undefined for the rows of a codebook.
 */
export declare function readShapeRows(k: Kernels, payload: Payload, escapes?: number): number[];
/** Columns of a scalar or float stream. */
export declare function readPlainColumns(k: Kernels, stream: StreamRecord): number[];
/** Rows of one SH band. */
export declare function readBand(k: Kernels, stream: StreamRecord, target: number): void;
/** The attribute of each SH band from 1. */
export declare function bandAttributes(degree: number): readonly number[];
