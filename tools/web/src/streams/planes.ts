import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { checkFrame } from "./zstd_frame.js";

/** Length of a decoded plane at most, bytes (SPEC 9.1). */
const MAX_PLANE_BYTES = 8_388_608;
const STORED_BYTES_MASK = 0x3fff_ffff;
const PACKED = 0x4000_0000;
const COMPRESSED = 0x8000_0000;

/** A stored plane: its word and the address of its bytes. */
export interface StoredPlane {
  readonly word: number;
  readonly address: number;
}

/** Return the stored length of a plane from its word, bytes. */
export function storedBytes(word: number): number {
  return word & STORED_BYTES_MASK;
}

/**
 * Decode the bytes of a plane (SPEC 6.3, 6.9).
 *
 * @param k - Kernels whose memory holds the stored plane; an uncompressed plane is not copied.
 * @param plane - The plane.
 * @param length - Decoded length, bytes.
 * @returns Address of `length` bytes.
 */
export function readPlane(k: Kernels, plane: StoredPlane, length: number): number {
  const { word, address } = plane;
  const stored = storedBytes(word);
  if (length > MAX_PLANE_BYTES) throw new CogsplatError("plane-length", `a plane of ${length} bytes`);
  const compressed = (word & COMPRESSED) !== 0;
  if ((word & PACKED) === 0) return readBytes(k, address, stored, length, compressed);
  const radix = stored > 0 ? k.u8[address]! : 0;
  if (radix < 2 || radix > 16) throw new CogsplatError("plane-radix", `a packed plane of radix ${radix}`);
  const packedLength = Math.ceil(length / symbolsPerByte(radix));
  const packed = readBytes(k, address + 1, stored - 1, packedLength, compressed);
  const target = k.alloc(length);
  if (k.unpackDigits(packed, length, radix, target) !== 0) {
    throw new CogsplatError("plane-digits", `a symbol that a packed plane of radix ${radix} cannot have`);
  }
  return target;
}

function readBytes(k: Kernels, address: number, stored: number, length: number, compressed: boolean): number {
  if (!compressed) {
    if (stored !== length) throw new CogsplatError("plane-length", `${stored} bytes, expected ${length}`);
    return address;
  }
  checkFrame(k.u8.subarray(address, address + stored), length, address);
  const target = k.alloc(length);
  if (k.zstd(address, stored, target, length) !== 0) {
    throw new CogsplatError("zstd-frame", `a frame that does not give the ${length} bytes it states`);
  }
  return target;
}

/** Return the number of symbols in a packed byte: the largest count with radix^count ≤ 256 (SPEC 6.9). */
function symbolsPerByte(radix: number): number {
  return radix === 2 ? 8 : radix === 3 ? 5 : radix === 4 ? 4 : radix <= 6 ? 3 : 2;
}

/** Refuse nonzero padding bits (SPEC 6.5). */
export function checkPadding(k: Kernels, address: number, bits: number): void {
  if (bits % 8 !== 0 && k.u8[address + (bits >>> 3)]! >>> (bits & 7) !== 0) {
    throw new CogsplatError("bits-padding", `padding after ${bits} bits is not zero`);
  }
}
