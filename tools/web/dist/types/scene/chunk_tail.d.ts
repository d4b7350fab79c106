import type { Kernels } from "../kernels/kernels.js";
import { type Payload } from "../streams/records.js";
import { type ShnCoordinates } from "../streams/shn_basis.js";
import { type Codebooks, type ColourCodebook } from "./codebooks.js";
/** SH coefficients above DC of a chunk, in the form in which its tail has them. */
export type TailSource = {
    readonly form: "bands"; /** For each band the address of its rows, where it is there. */
    readonly bands: readonly (number | undefined)[];
} | {
    readonly form: "indices";
    readonly indices: number;
    readonly codebook: ColourCodebook;
    readonly escapes: readonly (number | undefined)[];
} | {
    readonly form: "basis";
    readonly coordinates: ShnCoordinates; /** Rows of 48 f32. */
    readonly basis: number;
};
/**
 * Read a tail up to a degree (SPEC 7.3).
 *
 * @param needs - Codebooks that the tail's segment needs.
 * @param shDegree - Degree of the scene.
 * @param degree - Degree wanted; bands above it are not read.
 */
export declare function readTail(k: Kernels, tail: Payload, needs: number, codebooks: Codebooks, shDegree: number, degree: number): TailSource;
/**
 * The coefficients of every row, one after the other.
 *
 * @param target - Address of `rows` rows of 3·((degree + 1)² − 1) f32.
 */
export declare function writeShn(k: Kernels, source: TailSource, rows: number, degree: number, target: number): void;
/** Values of a row's coefficients above DC. */
export declare function shnFloats(degree: number): number;
