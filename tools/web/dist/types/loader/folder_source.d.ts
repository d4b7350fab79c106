import type { ByteRange } from "../container/scene_index.js";
import type { FolderIndex } from "../container/folder_index.js";
import { type Answer, type ByteSource, type ReadOptions } from "./byte_source.js";
/** The manifest and the objects of a folder as one source, by the addresses of `FolderIndex`. */
export declare class FolderSource implements ByteSource {
    private readonly manifest;
    private readonly index;
    /** Whether the server answers ranges, as far as it is known. */
    private hasRanges;
    /** What a server without ranges sends or has sent whole, once for all ranges of an object. */
    private readonly kept;
    constructor(manifest: ByteSource, index: FolderIndex, 
    /** Whether the server answers ranges, as far as it is known. */
    hasRanges: boolean);
    read(range: ByteRange, options?: ReadOptions): Promise<Answer>;
    private ask;
    /** All bytes of an object, from a server without ranges. */
    private whole;
}
