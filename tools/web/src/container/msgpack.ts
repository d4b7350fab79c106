import { CogsplatError } from "../errors.js";

/** A msgpack float 64; a class of its own, because SPEC refuses an integer in place of a float. */
export class Float {
  constructor(readonly value: number) {}
}

/** A value of the msgpack subset of SPEC 4.1; integers are numbers. */
export type Value = null | boolean | number | Float | string | Uint8Array | readonly Value[] | ValueMap;
/** A map of the subset; a `Map`, because `__proto__` is an ordinary key. */
export type ValueMap = Map<string, Value>;

/** Nesting depth of arrays and maps at most, the outermost map included (SPEC 9.1). */
const MAX_DEPTH = 8;
/** Values of a map at most (SPEC 4.1); a map of cameras may have more. */
const MAX_VALUES = 4_096;

// `ignoreBOM` keeps a leading U+FEFF, which is a character of the str.
const UTF8 = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });

/**
 * Read the single map of a root, a page or a metadata payload.
 *
 * @param bytes - The bytes of the map, nothing after it.
 * @param maxValues - Values at most, counting maps, keys and elements.
 * @throws CogsplatError `msgpack-…` for the first fault in the order of the bytes.
 */
export function parseMap(bytes: Uint8Array, maxValues = MAX_VALUES): ValueMap {
  const parser = new Parser(bytes, maxValues);
  const value = parser.value(0);
  if (!(value instanceof Map)) throw new CogsplatError("msgpack-type", "the outermost value is no map", 0);
  if (parser.at !== bytes.length) {
    throw new CogsplatError("msgpack-trailing", `${bytes.length - parser.at} bytes after the map`, parser.at);
  }
  return value;
}

class Parser {
  at = 0;
  private readonly view: DataView;
  /** Number of values announced so far. */
  private values = 1;

  constructor(
    private readonly bytes: Uint8Array,
    private readonly maxValues: number,
  ) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  value(depth: number): Value {
    const start = this.at;
    const tag = this.view.getUint8(this.take(1));
    if (tag < 0x80) return tag;
    if (tag < 0x90) return this.map(tag & 15, depth, start);
    if (tag < 0xa0) return this.array(tag & 15, depth, start);
    if (tag < 0xc0) return this.text(tag & 31);
    if (tag >= 0xe0) return tag - 256;
    switch (tag) {
      case 0xc0:
        return null;
      case 0xc1:
        throw new CogsplatError("msgpack-invalid", "the byte 0xC1", start);
      case 0xc2:
        return false;
      case 0xc3:
        return true;
      case 0xc4:
        return this.binary(this.length(1, 0, start));
      case 0xc5:
        return this.binary(this.length(2, 0x100, start));
      case 0xc6:
        return this.binary(this.length(4, 0x10000, start));
      case 0xca:
        throw new CogsplatError("msgpack-canonical", "a float 32", start);
      case 0xcb:
        return new Float(this.view.getFloat64(this.take(8)));
      case 0xcc:
        return this.length(1, 0x80, start);
      case 0xcd:
        return this.length(2, 0x100, start);
      case 0xce:
        return this.length(4, 0x10000, start);
      case 0xcf:
        return this.wide(start, false);
      case 0xd0:
        return this.negative(this.view.getInt8(this.take(1)), -32, start);
      case 0xd1:
        return this.negative(this.view.getInt16(this.take(2)), -0x80, start);
      case 0xd2:
        return this.negative(this.view.getInt32(this.take(4)), -0x8000, start);
      case 0xd3:
        return this.wide(start, true);
      case 0xd9:
        return this.text(this.length(1, 32, start));
      case 0xda:
        return this.text(this.length(2, 0x100, start));
      case 0xdb:
        return this.text(this.length(4, 0x10000, start));
      case 0xdc:
        return this.array(this.length(2, 16, start), depth, start);
      case 0xdd:
        return this.array(this.length(4, 0x10000, start), depth, start);
      case 0xde:
        return this.map(this.length(2, 16, start), depth, start);
      case 0xdf:
        return this.map(this.length(4, 0x10000, start), depth, start);
      default:
        throw new CogsplatError("msgpack-type", "an extension", start);
    }
  }

  private take(count: number): number {
    const start = this.at;
    if (count > this.bytes.length - start) {
      throw new CogsplatError(
        "msgpack-truncated",
        `${count} bytes needed where ${this.bytes.length - start} are left`,
        start,
      );
    }
    this.at = start + count;
    return start;
  }

  /** Read an unsigned integer of 1, 2 or 4 bytes, and refuse one that a shorter encoding could hold. */
  private length(size: 1 | 2 | 4, least: number, start: number): number {
    const at = this.take(size);
    const value = size === 1 ? this.view.getUint8(at) : size === 2 ? this.view.getUint16(at) : this.view.getUint32(at);
    if (value < least) throw new CogsplatError("msgpack-canonical", `${value} in ${size} bytes`, start);
    return value;
  }

  private negative(value: number, above: number, start: number): number {
    if (value >= above) throw new CogsplatError("msgpack-canonical", `${value} in more bytes than needed`, start);
    return value;
  }

  private wide(start: number, signed: boolean): number {
    const at = this.take(8);
    const value = signed ? this.view.getBigInt64(at) : this.view.getBigUint64(at);
    if (signed ? value >= -0x80000000n : value < 0x100000000n) {
      throw new CogsplatError("msgpack-canonical", `${value} in 8 bytes`, start);
    }
    const number = Number(value);
    if (!Number.isSafeInteger(number)) throw new CogsplatError("msgpack-integer", `${value} is beyond 2^53 - 1`, start);
    return number;
  }

  private text(length: number): string {
    const start = this.take(length);
    try {
      return UTF8.decode(this.bytes.subarray(start, start + length));
    } catch {
      throw new CogsplatError("msgpack-utf8", "a str that is not UTF-8", start);
    }
  }

  private binary(length: number): Uint8Array {
    const start = this.take(length);
    return this.bytes.subarray(start, start + length);
  }

  /** Refuse excessive nesting, more values than the remaining bytes can hold, and more values than the limit. */
  private enter(values: number, depth: number, start: number): void {
    if (depth >= MAX_DEPTH) throw new CogsplatError("msgpack-depth", `nested deeper than ${MAX_DEPTH}`, start);
    if (values > this.bytes.length - this.at) {
      throw new CogsplatError("msgpack-truncated", `${values} values in ${this.bytes.length - this.at} bytes`, start);
    }
    this.values += values;
    if (this.values > this.maxValues) {
      throw new CogsplatError("msgpack-count", `${this.values} values, at most ${this.maxValues}`, start);
    }
  }

  private array(count: number, depth: number, start: number): readonly Value[] {
    this.enter(count, depth, start);
    const values: Value[] = [];
    for (let i = 0; i < count; i++) values.push(this.value(depth + 1));
    return values;
  }

  private map(count: number, depth: number, start: number): ValueMap {
    this.enter(2 * count, depth, start);
    const values: ValueMap = new Map();
    for (let i = 0; i < count; i++) {
      const keyStart = this.at;
      const key = this.value(depth + 1);
      if (typeof key !== "string") throw new CogsplatError("msgpack-key", "a key that is no str", keyStart);
      if (values.has(key))
        throw new CogsplatError("msgpack-duplicate-key", `the key ${JSON.stringify(key)} twice`, keyStart);
      values.set(key, this.value(depth + 1));
    }
    return values;
  }
}
