import { CogsplatError } from "../errors.js";
import { type Value, type ValueMap } from "./msgpack.js";
/** The keys of one map of SPEC 4 and 5, taken by name and checked as they are taken. */
export declare class Fields {
    private readonly map;
    readonly where: string;
    private readonly taken;
    /**
     * @param map - The map.
     * @param where - What the map is, for messages.
     */
    constructor(map: ValueMap, where: string);
    /** Whether the key is there. */
    has(key: string): boolean;
    integer(key: string, least: number, most: number): number;
    float(key: string, fits: (value: number) => boolean, range: string): number;
    /** An array of so many finite floats. */
    floats(key: string, count: number): number[];
    boolean(key: string): boolean;
    text(key: string): string;
    array(key: string): readonly Value[];
    /** An array of maps, each with the fields of its own. */
    maps(key: string, most: number): Fields[];
    fields(key: string): Fields;
    binary(key: string): Uint8Array;
    /**
     * A column: a bin of rows of a fixed size.
     *
     * @param rows - How many rows it must have; without it, as many as there are.
     */
    column(key: string, rowBytes: number, rows?: number): DataView;
    /** Skip the keys that were not taken, and refuse those that must be understood (SPEC 4.3). */
    finish(): void;
    /** The refusal of a value out of range, for checks that are not made here. */
    outOfRange(key: string, found: string): CogsplatError;
    private wrongType;
    private required;
}
/** Bytes of a str in UTF-8. */
export declare function textBytes(text: string): number;
