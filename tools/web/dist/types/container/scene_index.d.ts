import { type CodebookEntry, type PageEntry, type SceneInfo } from "./root.js";
import { type ChunkTable, type SegmentTable } from "./tables.js";
/** A run of bytes of the file. */
export interface ByteRange {
    readonly offset: number;
    readonly length: number;
}
/** Where the segments of a scene and the pages of its index are, in whatever they are read from. */
export interface ScenePlaces {
    /** Where a segment is. */
    range(segment: number): ByteRange;
    /** Where the next page that was not read is, or undefined where all were. */
    nextPage(): ByteRange | undefined;
    /** Read the page that `nextPage` tells of. */
    addPage(bytes: Uint8Array): void;
}
/** The segments of one chunk; −1 where it has none that is known. */
export interface ChunkSegments {
    readonly head: number;
    readonly refinement: number;
    readonly tail: number;
    readonly attributes: number;
    /** Segments of its splats' opacities at later levels, in the order of the levels. */
    readonly opacities: readonly number[];
}
/**
 * The index of a file: the root and as many pages as were read (SPEC 3 to 5).
 *
 * Files are refused in the order of SPEC 8.1: `open` and `addPage` check each index by itself, `settle` what the
 * segments of all of them say together. Chunks are known once they are settled.
 */
export declare class SceneIndex {
    readonly scene: SceneInfo;
    readonly codebooks: readonly CodebookEntry[];
    readonly fileLength: number;
    readonly rootLength: number;
    readonly pages: readonly PageEntry[];
    segments: SegmentTable;
    chunks: ChunkTable;
    /** First byte of each segment in the file. */
    offsets: Float64Array<ArrayBuffer>;
    /** Pages that were read. */
    pagesRead: number;
    /** Segments of compensation, of cameras and of the view table, in file order. */
    readonly compensation: number[];
    readonly cameras: number[];
    readonly viewTables: number[];
    private readonly totalChunks;
    private readonly heads;
    private readonly tails;
    private readonly refinements;
    private readonly attributes;
    private readonly opacities;
    /** For each codebook the segments of its kinds. */
    private readonly codebookSegments;
    /** Where what was read last ends. */
    private end;
    /** Segments whose owners were noted. */
    private settled;
    private constructor();
    /**
     * Read preamble and root.
     *
     * @param bytes - The beginning of the file, at least to the end of the root.
     * @param sourceLength - Length of the source, where it is known: compared with what the file states.
     * @param partial - Whether a source shorter than the file is accepted (SPEC 8.3).
     */
    static open(bytes: Uint8Array, sourceLength?: number, partial?: boolean): SceneIndex;
    /** Where the next page that was not read is, or undefined where all were. */
    nextPage(): ByteRange | undefined;
    /** Read the page that `nextPage` tells of. */
    addPage(bytes: Uint8Array): void;
    /** Number of chunks that are known. */
    get chunkCount(): number;
    /** Number of chunks of the whole file. */
    get totalChunkCount(): number;
    /** Whether root and all pages were read. */
    get complete(): boolean;
    /** The segments of a chunk whose index is known. */
    chunkSegments(chunk: number): ChunkSegments;
    /** Whether a prefix of so many chunks draws one of them: whether it has not ended (SPEC 5.10). */
    isDrawn(chunk: number, prefix: number): boolean;
    /** The segment that has a chunk's opacities at a level; undefined where the head has them (SPEC 5.11). */
    opacitiesAt(chunk: number, level: number): number | undefined;
    /** The levels that draw a chunk. */
    levelsOf(chunk: number): number[];
    /** Where a segment is in the file. */
    range(segment: number): ByteRange;
    /**
     * The segments of the codebooks that a segment needs, up to the band of a degree.
     *
     * @returns Segment numbers; undefined where one stands in a page that was not read.
     */
    codebookSegmentsOf(segment: number, degree: number): number[] | undefined;
    /** The segments of all codebooks, those that no chunk needs too, codebook by codebook. */
    allCodebookSegments(): number[];
    /** Refuse a payload whose CRC is not the table's. */
    checkCrc(segment: number, payload: Uint8Array): void;
    /** Compare the length of the source with what the file states (SPEC 8.3). */
    private checkSource;
    /**
     * Check what the segments that were read since the last call say together, and note whose they are.
     *
     * What depends on the whole file is checked once all pages were read.
     */
    settle(): void;
    /** Give the segments of one index their places, and compare the number of its heads with that of its chunks. */
    private enterSegments;
    private enterHeads;
    /** Note the segments that a chunk has at most once, behind its head. */
    private enterOnce;
    /** Note the opacities of later levels, behind their chunks' heads and no more than there are levels. */
    private enterOpacities;
    private checkEnds;
    private checkSplats;
    private checkNeeds;
    private enterCodebooks;
    private enterCameras;
    private enterViewTable;
    private enterCompensation;
    /** Segments of a kind from a row on, each with its owner. */
    private ofKind;
    /** Kinds of the segments that a codebook has up to a degree. */
    private kindsOf;
}
