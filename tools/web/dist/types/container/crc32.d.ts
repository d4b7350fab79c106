/**
 * The CRC-32 of zlib and PNG (SPEC 2.1).
 *
 * @param bytes - What is checked.
 * @returns An unsigned 32-bit number.
 */
export declare function crc32(bytes: Uint8Array): number;
