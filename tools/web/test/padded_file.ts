import { crc32 } from "../src/container/crc32.js";
import { Float, parseMap, type Value, type ValueMap } from "../src/container/msgpack.js";

/** A segment kind that readers skip. */
const SKIPPED = 200;

/**
 * A file with a long segment to be skipped behind another, so that it is longer than the first request.
 *
 * @param file - A file without pages.
 * @param bytes - Length of the segment.
 * @param after - Number of the other segment; by default that of the first head.
 */
export function padSegments(file: Uint8Array, bytes: number, after?: number): Uint8Array {
  const view = new DataView(file.buffer, file.byteOffset);
  const rootEnd = 64 + view.getUint32(12, true);
  const root = parseMap(file.slice(64, rootEnd));
  const segments = root.get("segments") as ValueMap;
  const kinds = segments.get("kind") as Uint8Array;
  const head = after ?? kinds.indexOf(1);
  const lengths = segments.get("length") as Uint8Array;
  const lengthView = new DataView(lengths.buffer, lengths.byteOffset);
  let split = rootEnd;
  for (let i = 0; i <= head; i++) split += lengthView.getUint32(4 * i, true);
  const padding = Uint8Array.from({ length: bytes }, (_, i) => (i * 31) & 255);
  const row: Record<string, Uint8Array> = {
    kind: Uint8Array.of(SKIPPED),
    owner: u32(0),
    length: u32(bytes),
    crc: u32(crc32(padding)),
    hash: new Uint8Array(16),
    needs: u32(0),
  };
  for (const [key, added] of Object.entries(row)) {
    const column = segments.get(key) as Uint8Array;
    const at = (head + 1) * added.length;
    segments.set(key, join(column.slice(0, at), added, column.slice(at)));
  }
  return withRoot(file, root, join(file.slice(rootEnd, split), padding, file.slice(split)));
}

/** The file with another root and other bytes behind it. */
export function withRoot(file: Uint8Array, root: ValueMap, rest: Uint8Array): Uint8Array {
  const newRoot = encode(root);
  const preamble = file.slice(0, 64);
  const header = new DataView(preamble.buffer);
  header.setUint32(12, newRoot.length, true);
  header.setBigUint64(16, BigInt(64 + newRoot.length + rest.length), true);
  header.setUint32(24, crc32(newRoot), true);
  header.setUint32(60, crc32(preamble.slice(0, 60)), true);
  return join(preamble, newRoot, rest);
}

/** Encode a msgpack value. */
export function encode(value: Value): Uint8Array {
  if (value === null) return Uint8Array.of(0xc0);
  if (typeof value === "boolean") return Uint8Array.of(value ? 0xc3 : 0xc2);
  if (typeof value === "number") return integer(value);
  if (value instanceof Float) {
    const bytes = new Uint8Array(9);
    bytes[0] = 0xcb;
    new DataView(bytes.buffer).setFloat64(1, value.value);
    return bytes;
  }
  if (typeof value === "string") {
    const text = new TextEncoder().encode(value);
    return join(text.length < 32 ? Uint8Array.of(0xa0 | text.length) : sized(text.length, [0xd9, 0xda, 0xdb]), text);
  }
  if (value instanceof Uint8Array) return join(sized(value.length, [0xc4, 0xc5, 0xc6]), value);
  const isMap = value instanceof Map;
  const parts = isMap ? [...value].flat() : [...(value as readonly Value[])];
  const count = isMap ? parts.length / 2 : parts.length;
  const front =
    count < 16 ? Uint8Array.of((isMap ? 0x80 : 0x90) | count) : sized(count, isMap ? [0, 0xde, 0xdf] : [0, 0xdc, 0xdd]);
  return join(front, ...parts.map((part) => encode(part as Value)));
}

function integer(value: number): Uint8Array {
  if (value < 0) throw new RangeError("no vector that is padded has a negative integer");
  return value < 128 ? Uint8Array.of(value) : sized(value, [0xcc, 0xcd, 0xce]);
}

/** A tag and a number in the fewest of 1, 2 and 4 bytes; tag 0 means that there is none of one byte. */
function sized(value: number, tags: readonly [number, number, number]): Uint8Array {
  const size = value < 0x100 && tags[0] !== 0 ? 0 : value < 0x10000 ? 1 : 2;
  const bytes = new Uint8Array(1 + 2 ** size);
  bytes[0] = tags[size]!;
  for (let i = 0; i < 2 ** size; i++) bytes[bytes.length - 1 - i] = value >>> (8 * i);
  return bytes;
}

/** Little-endian bytes of a u32. */
export function u32(value: number): Uint8Array {
  const bytes = new Uint8Array(4);
  new DataView(bytes.buffer).setUint32(0, value, true);
  return bytes;
}

export function join(...parts: readonly Uint8Array[]): Uint8Array {
  const joined = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    joined.set(part, at);
    at += part.length;
  }
  return joined;
}
