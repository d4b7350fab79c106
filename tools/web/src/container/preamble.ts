import { CogsplatError } from "../errors.js";
import { crc32 } from "./crc32.js";

/** Length of the preamble, bytes. */
export const PREAMBLE_BYTES = 64;
/** Length of a root at most, bytes: it ends at byte 16,384 (SPEC 3.3). */
const MAX_ROOT_BYTES = 16_320;
const MAGIC = Uint8Array.of(0x89, 0x43, 0x4f, 0x47, 0x53, 0x0d, 0x0a, 0x1a);
/** Magic bytes of the manifest of a folder (SPEC 3.4). */
const MANIFEST_MAGIC = Uint8Array.of(0x89, 0x43, 0x4f, 0x47, 0x4d, 0x0d, 0x0a, 0x1a);
const MAJOR = 0;
const MINOR = 3;

/** Contents of the preamble, the first 64 bytes (SPEC 3.1). */
export interface Preamble {
  readonly rootLength: number;
  readonly fileLength: number;
  readonly rootCrc: number;
}

/**
 * Read and check the preamble.
 *
 * @param bytes - First bytes of the file.
 */
export function readPreamble(bytes: Uint8Array): Preamble {
  const magic = bytes.subarray(0, MAGIC.length);
  if (magic.some((byte, i) => byte !== MAGIC[i])) {
    throw new CogsplatError("not-cogs", `the file begins with ${hex(magic, " ") || "nothing"}`, 0);
  }
  if (bytes.length < PREAMBLE_BYTES) {
    throw new CogsplatError("preamble-truncated", `${bytes.length} bytes where the preamble has ${PREAMBLE_BYTES}`, 0);
  }
  const view = new DataView(bytes.buffer, bytes.byteOffset, PREAMBLE_BYTES);
  if (crc32(bytes.subarray(0, 60)) !== view.getUint32(60, true)) {
    throw new CogsplatError("preamble-crc", "the preamble's CRC does not match", 60);
  }
  const major = view.getUint16(8, true);
  if (major !== MAJOR) throw new CogsplatError("version-major", `major version ${major}`, 8);
  const minor = view.getUint16(10, true);
  if (minor !== MINOR)
    throw new CogsplatError("version-minor", `minor version ${minor}, this reader knows ${MINOR}`, 10);
  for (let at = 28; at < 60; at++) {
    if (bytes[at] !== 0) throw new CogsplatError("preamble-reserved", `reserved byte ${bytes[at]}`, at);
  }
  const rootLength = view.getUint32(12, true);
  if (rootLength < 1 || rootLength > MAX_ROOT_BYTES) {
    throw new CogsplatError("root-length", `a root of ${rootLength} bytes`, 12);
  }
  const fileLength = view.getBigUint64(16, true);
  if (fileLength < BigInt(PREAMBLE_BYTES + rootLength) || fileLength > BigInt(Number.MAX_SAFE_INTEGER)) {
    throw new CogsplatError("file-length", `a file of ${fileLength} bytes with a root of ${rootLength}`, 16);
  }
  return { rootLength, fileLength: Number(fileLength), rootCrc: view.getUint32(24, true) };
}

/** Return whether bytes begin with the magic of a folder's manifest (SPEC 3.4). */
export function isManifest(bytes: Uint8Array): boolean {
  return bytes.length >= MANIFEST_MAGIC.length && MANIFEST_MAGIC.every((byte, i) => bytes[i] === byte);
}

/**
 * Return the first bytes of the file that a manifest stands for: magic and CRC replaced.
 *
 * @param manifest - First bytes of the manifest, at least 64.
 */
export function fileBeginning(manifest: Uint8Array): Uint8Array<ArrayBuffer> {
  const bytes = Uint8Array.from(manifest);
  const view = new DataView(bytes.buffer);
  if (crc32(bytes.subarray(0, 60)) !== view.getUint32(60, true)) {
    throw new CogsplatError("preamble-crc", "the CRC of the manifest's preamble does not match", 60);
  }
  bytes.set(MAGIC);
  view.setUint32(60, crc32(bytes.subarray(0, 60)), true);
  return bytes;
}

/** Return bytes as hexadecimal digits. */
export function hex(bytes: Uint8Array, between = ""): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join(between);
}
