import { CogsplatError } from "../errors.js";

/** Maximum window of a frame, bytes (SPEC 6.3). */
const MAX_WINDOW = 8_388_608;
/** Maximum length of a block, bytes (RFC 8878, 3.1.1.2.4). */
const MAX_BLOCK = 131_072;

/**
 * Check a zstd frame before it is decompressed (SPEC 6.3).
 *
 * zstd decoders for browsers accept truncated frames, wrong sizes and trailing bytes, so this function checks the
 * header and the chain of blocks itself.
 *
 * @param frame - The stored bytes of the plane, nothing else.
 * @param length - Decompressed length, bytes.
 * @param offset - Offset of the frame in its payload, for messages.
 */
export function checkFrame(frame: Uint8Array, length: number, offset: number): void {
  const refuse = (found: string) => new CogsplatError("zstd-frame", found, offset);
  if (frame[0] !== 0x28 || frame[1] !== 0xb5 || frame[2] !== 0x2f || frame[3] !== 0xfd) throw refuse("no zstd frame");
  const descriptor = frame[4];
  if (descriptor === undefined) throw refuse("a frame header that is cut");
  const single = (descriptor & 0x20) !== 0;
  const dictionaryBytes = [0, 1, 2, 4][descriptor & 3]!;
  const sizeBytes = [single ? 1 : 0, 2, 4, 8][descriptor >>> 6]!;
  const windowAt = 5;
  const sizeAt = windowAt + (single ? 0 : 1) + dictionaryBytes;
  if (sizeAt + sizeBytes > frame.length) throw refuse("a frame header that is cut");
  if ((descriptor & 0x08) !== 0) throw refuse("the reserved bit of a frame header is set");
  const size = contentSize(frame, sizeAt, sizeBytes);
  if (size !== length) {
    throw new CogsplatError("zstd-size", `a frame of ${size ?? "unstated"} bytes, expected ${length}`, offset);
  }
  const window = single ? size : windowSize(frame[windowAt]!);
  if (window > MAX_WINDOW) throw new CogsplatError("zstd-window", `a window of ${window} bytes`, offset);
  if (dictionaryBytes > 0) throw new CogsplatError("zstd-dictionary", "a frame with a dictionary", offset);
  if ((descriptor & 0x04) !== 0) throw new CogsplatError("zstd-checksum", "a frame with a checksum", offset);
  walkBlocks(frame, sizeAt + sizeBytes, Math.min(window, MAX_BLOCK), refuse);
}

/** Return the content size in a frame header, bytes; undefined if the header has none (RFC 8878, 3.1.1.1.4). */
function contentSize(frame: Uint8Array, at: number, bytes: number): number | undefined {
  if (bytes === 0) return undefined;
  let size = bytes === 2 ? 256 : 0;
  for (let i = 0; i < bytes; i++) size += frame[at + i]! * 2 ** (8 * i);
  return size;
}

/** Return the window size of a window descriptor, bytes (RFC 8878, 3.1.1.1.2). */
function windowSize(descriptor: number): number {
  const base = 2 ** (10 + (descriptor >>> 3));
  return base + (base / 8) * (descriptor & 7);
}

/** Follow the block headers to the end of the frame, which must be the end of the plane. */
function walkBlocks(frame: Uint8Array, start: number, largest: number, refuse: (found: string) => CogsplatError): void {
  for (let at = start; ; ) {
    if (at + 3 > frame.length) throw refuse("a frame that is cut");
    const header = frame[at]! | (frame[at + 1]! << 8) | (frame[at + 2]! << 16);
    const type = (header >>> 1) & 3;
    const size = header >>> 3;
    if (type === 3) throw refuse("a block of the reserved type");
    if (size > largest) throw refuse(`a block of ${size} bytes`);
    at += 3 + (type === 1 ? 1 : size);
    if (at > frame.length) throw refuse("a frame that is cut");
    if ((header & 1) !== 0) {
      if (at !== frame.length) throw refuse(`${frame.length - at} bytes after the frame`);
      return;
    }
  }
}
