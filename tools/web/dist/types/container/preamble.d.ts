/** Bytes of the preamble. */
export declare const PREAMBLE_BYTES = 64;
/** What the first 64 bytes state (SPEC 3.1). */
export interface Preamble {
    readonly rootLength: number;
    readonly fileLength: number;
    readonly rootCrc: number;
}
/**
 * Read and check the preamble.
 *
 * @param bytes - The beginning of the file.
 */
export declare function readPreamble(bytes: Uint8Array): Preamble;
