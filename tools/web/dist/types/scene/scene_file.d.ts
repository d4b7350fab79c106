import type { AttributeArray } from "../container/attributes.js";
import { type Camera } from "../container/cameras.js";
import { type ViewTable } from "../container/view_table.js";
import { type SceneInfo } from "../container/root.js";
import { SceneIndex } from "../container/scene_index.js";
import type { Kernels } from "../kernels/kernels.js";
import { type PackedSplats } from "./packed_splats.js";
import { type Splats } from "./splats.js";
/** How a file is opened. */
export interface FileOptions {
    /** Accept a beginning of the file and decode what is there (SPEC 8.3). */
    readonly partial?: boolean;
    /** Most decoded bytes (SPEC 9.2); by default 64 MiB and 256 for each byte of the source. */
    readonly maxDecodedBytes?: number;
}
/** A COGS file, or a beginning of one, that is in memory. */
export declare class SceneFile {
    private readonly bytes;
    private readonly k;
    readonly index: SceneIndex;
    private readonly decoder;
    private readonly maxDecodedBytes;
    private layers;
    /**
     * Open a file and check all of its index.
     *
     * @param bytes - The file, or with `partial` a beginning of it.
     * @param kernels - Memory and arithmetic for this file alone.
     */
    constructor(bytes: Uint8Array, k: Kernels, options?: FileOptions);
    /** What the root says of the scene. */
    get scene(): SceneInfo;
    /** Chunks of the prefix that is there (SPEC 8.2). */
    get prefixChunks(): number;
    /** Whether a chunk's coefficients above DC are there up to a degree. */
    tailIsThere(chunk: number, degree?: number): boolean;
    /** Whether a chunk's refinement is there. */
    refinementIsThere(chunk: number): boolean;
    /**
     * Decode one chunk.
     *
     * @param degree - SH degree wanted; by default the scene's.
     * @param refine - Whether the chunk's refinement is used where it is there.
     * @param level - Level whose opacities are wanted (SPEC 5.11); by default the last that is there.
     */
    decodeChunk(chunk: number, degree?: number, refine?: boolean, level?: number): Splats;
    /**
     * Decode one chunk into what a renderer uploads.
     *
     * @param ranges - What the codes stand for.
     */
    decodePacked(chunk: number, degree?: number, ranges?: import("./packed_splats.js").PackRanges): PackedSplats;
    /** Check that a chunk is there and small enough, decode its codebooks, and get its payloads. */
    private prepare;
    /** The segment that has a chunk's opacities at a level, or of those that are there the last; undefined for the head. */
    private opacitiesSegment;
    /** Decode the codebooks that a chunk needs and that were not decoded before. */
    private addCodebooks;
    private addCodebook;
    /**
     * Decode all chunks that the prefix draws, or a level, one after the other.
     *
     * @param level - Level wanted, 0 the coarsest (SPEC 5.11); by default all that is there.
     */
    decode(degree?: number, refine?: boolean, level?: number): Splats;
    /** A chunk's extra attributes; undefined where the chunk has none that are there. */
    attributes(chunk: number): Map<string, AttributeArray> | undefined;
    /** The cameras that the file brings; undefined where there are none. */
    cameras(): Camera[] | undefined;
    /** What each chunk adds to the pictures of some viewpoints; undefined where the file does not say, or it is not there. */
    viewTable(): ViewTable | undefined;
    /**
     * Add what the file says of missing chunks (SPEC 8.5) to rows of one chunk, in place.
     *
     * @param splats - The chunk's rows, decoded.
     * @param prefix - Number of chunks that are there, from the first on; where other chunks than these are there, what
     *   {@link equivalentPrefixes} says of the chunk.
     */
    compensate(splats: Splats, chunk: number, prefix: number): void;
    /**
     * Check everything of a whole file: hashes, codebooks, cameras, compensation, the view table, and of each chunk all that it has, in
     * the order of SPEC 8.10.
     *
     * @throws CogsplatError for the first fault.
     */
    verify(): Promise<void>;
    private checkBox;
    private readLayers;
    private headIsThere;
    /** Whether the codebooks that a segment needs are there: shapes, and colours up to a degree. */
    private booksAreThere;
    private isThere;
    private payload;
    /** Refuse what takes more memory than the caller allows (SPEC 9.2). */
    private checkSize;
    private checkBytes;
    /** Which arithmetic this file is decoded with. */
    get backend(): Kernels["backend"];
}
/** The limit of SPEC 9.2: 64 MiB and 256 bytes for each byte of the source. */
export declare function defaultLimit(sourceBytes: number): number;
