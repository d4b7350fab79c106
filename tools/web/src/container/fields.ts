import { CogsplatError } from "../errors.js";
import { Float, type Value, type ValueMap } from "./msgpack.js";

/** The fields of one msgpack map of SPEC 4 and 5, type-checked as they are read. */
export class Fields {
  private readonly taken = new Set<string>();

  /**
   * @param map - The map.
   * @param where - Name of the map, for messages.
   */
  constructor(
    private readonly map: ValueMap,
    readonly where: string,
  ) {}

  /** Return whether the map has a key. */
  has(key: string): boolean {
    return this.map.has(key);
  }

  integer(key: string, least: number, most: number): number {
    const value = this.required(key);
    if (typeof value !== "number") throw this.wrongType(key, "an integer");
    if (value < least || value > most) throw this.outOfRange(key, `${value} outside ${least} to ${most}`);
    return value;
  }

  float(key: string, fits: (value: number) => boolean, range: string): number {
    const value = this.required(key);
    if (!(value instanceof Float)) throw this.wrongType(key, "a float");
    if (!fits(value.value)) throw this.outOfRange(key, `${value.value} is not ${range}`);
    return value.value;
  }

  /** Read an array of `count` finite floats. */
  floats(key: string, count: number): number[] {
    const values = this.array(key);
    if (values.length !== count) throw this.outOfRange(key, `${values.length} values, expected ${count}`);
    return values.map((value) => {
      if (!(value instanceof Float) || !Number.isFinite(value.value)) {
        throw this.outOfRange(key, "an entry that is no finite float");
      }
      return value.value;
    });
  }

  boolean(key: string): boolean {
    const value = this.required(key);
    if (typeof value !== "boolean") throw this.wrongType(key, "a bool");
    return value;
  }

  text(key: string): string {
    const value = this.required(key);
    if (typeof value !== "string") throw this.wrongType(key, "a str");
    return value;
  }

  array(key: string): readonly Value[] {
    const value = this.required(key);
    if (!Array.isArray(value)) throw this.wrongType(key, "an array");
    return value as readonly Value[];
  }

  /** Read an array of at most `most` maps, one after the other. */
  maps<T>(key: string, most: number, read: (fields: Fields) => T): T[] {
    const values = this.array(key);
    if (values.length > most) throw this.outOfRange(key, `${values.length} entries, at most ${most}`);
    return values.map((value, i) => {
      if (!(value instanceof Map)) throw this.wrongType(key, "an array of maps");
      return read(new Fields(value, `${this.where}.${key}[${i}]`));
    });
  }

  fields(key: string): Fields {
    const value = this.required(key);
    if (!(value instanceof Map)) throw this.wrongType(key, "a map");
    return new Fields(value, `${this.where}.${key}`);
  }

  binary(key: string): Uint8Array {
    const value = this.required(key);
    if (!(value instanceof Uint8Array)) throw this.wrongType(key, "a bin");
    return value;
  }

  /**
   * Read a column: a bin of rows of a fixed size.
   *
   * @param rows - Number of rows expected; by default any.
   */
  column(key: string, rowBytes: number, rows?: number): DataView {
    const bytes = this.binary(key);
    if (rows === undefined ? bytes.length % rowBytes !== 0 : bytes.length !== rows * rowBytes) {
      throw new CogsplatError(
        "root-columns",
        `${this.where}.${key} has ${bytes.length} bytes for ${rows ?? "whole"} rows of ${rowBytes}`,
      );
    }
    return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  /** Skip the keys that were not read, and refuse an unknown key that a reader must understand (SPEC 4.3). */
  finish(): void {
    for (const key of this.map.keys()) {
      if (!this.taken.has(key) && key.endsWith("!")) {
        throw new CogsplatError("root-must-understand", `${this.where} has the key ${JSON.stringify(key)}`);
      }
    }
  }

  /** Return the error of a value out of range, for checks outside this class. */
  outOfRange(key: string, found: string): CogsplatError {
    return new CogsplatError("root-value", `${this.where}.${key}: ${found}`);
  }

  private wrongType(key: string, expected: string): CogsplatError {
    return new CogsplatError("root-type", `${this.where}.${key} is not ${expected}`);
  }

  private required(key: string): Value {
    this.taken.add(key);
    const value = this.map.get(key);
    if (value === undefined) throw new CogsplatError("root-missing", `${this.where} has no key ${JSON.stringify(key)}`);
    return value;
  }
}

/** Return the number of bytes of a string in UTF-8. */
export function textBytes(text: string): number {
  return new TextEncoder().encode(text).length;
}
