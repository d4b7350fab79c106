/**
 * Decompress a frame whose header and chain of blocks were checked (`checkFrame`).
 *
 * @param frame - All of the frame.
 * @param target - As many bytes as the frame states.
 * @returns False where the frame is damaged or gives another number of bytes.
 */
export declare function decompressFrame(frame: Uint8Array, target: Uint8Array): boolean;
