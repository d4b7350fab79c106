import type { Kernels } from "../kernels/kernels.js";
/** A plane as it is stored: its word and the address of its bytes. */
export interface StoredPlane {
    readonly word: number;
    readonly address: number;
}
/** Bytes that a plane's word says are stored. */
export declare function storedBytes(word: number): number;
/**
 * The bytes of a plane (SPEC 6.3, 6.9).
 *
 * @param k - Memory that holds the stored plane; planes that are stored as they are stay where they are.
 * @param plane - The plane.
 * @param length - Bytes that the plane has.
 * @returns Address of `length` bytes.
 */
export declare function readPlane(k: Kernels, plane: StoredPlane, length: number): number;
/** Refuse bits behind the last that count (SPEC 6.5). */
export declare function checkPadding(k: Kernels, address: number, bits: number): void;
