import { type AttributeArray } from "../container/attributes.js";
import type { SceneIndex } from "../container/scene_index.js";
import type { Kernels } from "../kernels/kernels.js";
import { type HeadColumns } from "./chunk_head.js";
import { type TailSource } from "./chunk_tail.js";
import { type PackedSplats, type PackRanges } from "./packed_splats.js";
import type { Splats } from "./splats.js";
/** The payloads of one chunk. */
export interface ChunkPayloads {
    readonly chunk: number;
    readonly head: Uint8Array;
    readonly refinement?: Uint8Array | undefined;
    /** Opacities of later levels, in the order of the levels; the splats have the last ones that are there. */
    readonly opacities?: readonly (Uint8Array | undefined)[] | undefined;
    readonly tail?: Uint8Array | undefined;
}
/** The tail of a chunk whose head was decoded before. */
export interface TailPayload {
    readonly chunk: number;
    readonly head?: undefined;
    readonly tail: Uint8Array;
}
/** What the decoder has to know of the file: a part of its index that can be sent to a worker. */
export type DecoderIndex = Pick<SceneIndex, "scene" | "codebooks">;
/** Decodes the chunks of one scene; codebooks stay in its memory from chunk to chunk. */
export declare class ChunkDecoder {
    readonly k: Kernels;
    private readonly index;
    private readonly codebooks;
    private readonly added;
    /**
     * @param k - Memory and arithmetic, for this scene alone.
     * @param index - What the root says.
     */
    constructor(k: Kernels, index: DecoderIndex);
    /** Decode a codebook's segment, once; its CRC was checked. */
    addCodebook(codebook: number, kind: number, payload: Uint8Array): void;
    /** Whether a codebook's segment was decoded. */
    hasCodebook(codebook: number, kind: number): boolean;
    /**
     * Decode a chunk and hand its columns to a function; its memory is given back afterwards.
     *
     * @param payloads - The chunk's payloads, whose CRCs were checked.
     * @param rows - Splats of the chunk.
     * @param needs - Codebooks that head and tail need.
     * @param degree - SH degree wanted, at most the scene's.
     * @param use - Is given addresses: of the head's columns, and of opacities level by level, the head's first.
     */
    withChunk<T>(payloads: ChunkPayloads, rows: number, needs: {
        readonly head: number;
        readonly tail: number;
    }, degree: number, use: (head: HeadColumns, tail: TailSource | undefined, opacities: readonly (number | undefined)[]) => T): T;
    /** Decode the opacities of a later level; those of the head stay as they are. Returns their address. */
    private laterOpacities;
    /** Decode a tail and hand it to a function; its memory is given back afterwards. */
    private withTail;
    private tailOf;
    /** Decode a chunk to the bit (SPEC 2.3). */
    decode(payloads: ChunkPayloads, rows: number, needs: {
        readonly head: number;
        readonly tail: number;
    }, degree: number): Splats;
    /**
     * Decode the coefficients above DC of a chunk alone, to the bit.
     *
     * @param payload - The tail, whose CRC was checked.
     * @param rows - Splats of the chunk.
     * @param needs - Codebooks that the tail needs.
     * @param degree - SH degree wanted, above 0 and at most the scene's.
     * @returns For each row 3·((degree + 1)² − 1) values.
     */
    decodeShN(payload: TailPayload, rows: number, needs: number, degree: number): Float32Array;
    /**
     * Decode a chunk into what a renderer uploads (SPEC 8.6).
     *
     * @param ranges - What the codes stand for.
     */
    decodePacked(payloads: ChunkPayloads, rows: number, needs: {
        readonly head: number;
        readonly tail: number;
    }, degree: number, ranges: PackRanges): PackedSplats;
    /**
     * Decode the packed bands of a chunk alone (SPEC 8.6); the parameters are those of `decodeShN` and `decodePacked`.
     */
    decodePackedBands(payload: TailPayload, rows: number, needs: number, degree: number, ranges: PackRanges): Uint32Array[];
    /** Decode a chunk's extra attributes (SPEC 5.7). */
    attributes(payload: Uint8Array, rows: number): Map<string, AttributeArray>;
    private shN;
    private packedBands;
    private rows;
}
