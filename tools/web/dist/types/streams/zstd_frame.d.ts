/**
 * Check a zstd frame before anything is decompressed (SPEC 6.3).
 *
 * Decoders for browsers accept cut frames, wrong sizes and bytes behind the frame without a word, so the header and
 * the chain of blocks are walked here.
 *
 * @param frame - Exactly the stored bytes of the plane.
 * @param length - Bytes that the frame must give.
 * @param offset - Where the frame is in its payload, for messages.
 */
export declare function checkFrame(frame: Uint8Array, length: number, offset: number): void;
