/** A msgpack float 64. A class of its own, because an integer in a float's place is refused. */
export declare class Float {
    readonly value: number;
    constructor(value: number);
}
/** A value of the msgpack subset of SPEC 4.1; integers are numbers. */
export type Value = null | boolean | number | Float | string | Uint8Array | readonly Value[] | ValueMap;
/** A map of the subset. A `Map`, because `__proto__` is a key like any other. */
export type ValueMap = Map<string, Value>;
/**
 * Read the one map that a root, an index page or a metadata payload is.
 *
 * @param bytes - Exactly the map.
 * @param maxValues - Most values, the map itself, keys and elements counted.
 * @returns The map.
 * @throws CogsplatError with a code `msgpack-…` for the first fault from front to back.
 */
export declare function parseMap(bytes: Uint8Array, maxValues?: number): ValueMap;
