import type { SceneIndex } from "../container/scene_index.js";
import type { PackRanges } from "../scene/packed_splats.js";
import type { ChunkService, ChunkFormat } from "../workers/decode_task.js";
import type { ChunkUpdate } from "./stream_options.js";
/** What is decoded and how. */
export interface DecodeOptions {
    readonly degree: number;
    readonly format: ChunkFormat;
    readonly ranges: PackRanges;
    readonly refine: boolean;
    /** Level whose opacities are wanted (SPEC 5.11); undefined for those of one level after the other, as they come. */
    readonly level?: number | undefined;
}
/**
 * Collects the payloads of chunks and decodes each chunk when its head and the codebooks that it needs are there, and
 * again when its refinement has come; of a tail that comes later the coefficients alone are decoded, where what the head
 * was decoded to could be kept.
 */
export declare class ChunkQueue {
    private readonly index;
    private readonly service;
    private readonly options;
    private readonly emit;
    private readonly fail;
    private readonly heads;
    private readonly payloads;
    private readonly codebooks;
    /** Segments that cannot be had. */
    private readonly lost;
    private readonly given;
    private readonly decoding;
    /** Chunks that were not yet given with all that they have. */
    private readonly open;
    constructor(index: SceneIndex, service: ChunkService, options: DecodeOptions, emit: (update: Omit<ChunkUpdate, "prefix">) => void, fail: (error: unknown, chunk: number) => void);
    /** Keep no more than so many bytes of decoded heads whose tails are still to come. */
    keepAtMost(bytes: number): void;
    /** Bytes of decoded heads whose tails are still to come. */
    get keptBytes(): number;
    /** Chunks from here on are decoded as their payloads come. */
    expect(chunk: number): void;
    /** The segments that the expected chunks still need, by chunk. */
    allMissing(): number[];
    /** The segments that a chunk still needs, in the order in which they help most. */
    private missing;
    /** The segments of opacities that are wanted of a chunk. */
    private opacities;
    /** The opacities of a chunk that have come: of packed chunks those of all levels, else the last. */
    private opacitiesHere;
    /** Whether a segment has come. */
    has(segment: number): boolean;
    /** Take a segment whose CRC was checked. */
    add(segment: number, payload: Uint8Array): void;
    /** Go on without a segment; gives the chunks that cannot be drawn for it, or that lack something. */
    lose(segment: number): number[];
    /** Whether every chunk that was expected has been given, or cannot be. */
    get idle(): boolean;
    private decode;
    /** Whether a chunk's tail may still come. */
    private expectsTail;
    /** Whether a segment and the codebooks that it needs are there. */
    private ready;
    private isLost;
    /** Forget a chunk's payloads: nothing more comes of it, unless it is expected again. */
    close(chunk: number): void;
    private rowStarts;
    private firstRow;
}
