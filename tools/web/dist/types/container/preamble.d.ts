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
/** Whether bytes begin as the manifest of a folder does (SPEC 3.4). */
export declare function isManifest(bytes: Uint8Array): boolean;
/**
 * The same bytes with the preamble of the file that a manifest stands for: its magic, and a CRC that matches.
 *
 * @param manifest - Its beginning, 64 bytes or more.
 */
export declare function fileBeginning(manifest: Uint8Array): Uint8Array<ArrayBuffer>;
/** Bytes as hexadecimal digits, two each. */
export declare function hex(bytes: Uint8Array, between?: string): string;
