import type { ByteRange, SceneIndex, ScenePlaces } from "./scene_index.js";
/** An object of a folder. */
export interface FolderObject {
    /** Relative to the manifest. */
    readonly name: string;
    readonly size: number;
}
/**
 * Where the segments of a scene are in the objects of a folder (SPEC 3.4).
 *
 * All objects are in one space of addresses: the manifest begins at 0, and the first object at 2^33, the second at 2 · 2^33, and so on.
 */
export declare class FolderIndex implements ScenePlaces {
    private readonly index;
    /** The manifest, which has no name, and the objects that are known. */
    private readonly objects;
    private readonly numbers;
    /** Address of each segment that is known. */
    private readonly addresses;
    /** First byte of the manifest behind what was read. */
    private end;
    /** Bytes of the manifest. */
    readonly manifestBytes: number;
    /**
     * @param index - Of the scene, its root alone.
     * @param manifest - Beginning of the manifest; the places of the root's segments are in its first 64 KiB.
     */
    constructor(index: SceneIndex, manifest: Uint8Array);
    /** Compare the length of the manifest with what its root says. */
    checkLength(length: number): void;
    range(segment: number): ByteRange;
    nextPage(): ByteRange | undefined;
    addPage(bytes: Uint8Array): void;
    /** The object that an address is in, and where in it; the manifest has no name. */
    at(address: number): {
        readonly object: FolderObject;
        readonly offset: number;
    };
    /** Take the places of the segments behind those that have one. */
    private enter;
    private numberOf;
}
