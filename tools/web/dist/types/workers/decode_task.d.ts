import type { KernelsMaker } from "../kernels/load.js";
import { type ChunkPayloads, type DecoderIndex, type TailPayload } from "../scene/chunk_decoder.js";
import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";
import type { Splats } from "../scene/splats.js";
import { type TexelArray, type TexelLayout, type Texels } from "../scene/texels.js";
/** What chunks are decoded to: arrays to the bit, 16 bytes and packed bands, or the textures of a renderer. */
export type ChunkFormat = "splats" | "packed" | TexelLayout;
/** One chunk to decode; everything in it can be sent to a worker. */
export interface DecodeTask {
    /** Without a head, bands alone are decoded. */
    readonly payloads: ChunkPayloads | TailPayload;
    readonly rows: number;
    readonly needs: {
        readonly head: number;
        readonly tail: number;
    };
    readonly degree: number;
    readonly format: ChunkFormat;
    /** For packed chunks: what their codes stand for. */
    readonly ranges: PackRanges;
}
/** Coefficients above DC: all of `splats`, or a band of `packed` or of a renderer's textures. */
export type BandArray = Float32Array | Uint32Array | TexelArray;
/** A decoded chunk: one of the four, as the task asked. */
export interface DecodedChunk {
    readonly splats?: Splats;
    readonly packed?: PackedSplats;
    readonly texels?: Texels;
    /** Of a task without a head: `shN`, the packed bands, or the textures behind those that hold none. */
    readonly bands?: readonly BandArray[];
}
/** Decodes the chunks of one scene, here or in workers. */
export interface ChunkService {
    /** Hand over a codebook's segment before the first chunk that needs it. */
    addCodebook(codebook: number, kind: number, payload: Uint8Array): void;
    decode(task: DecodeTask): Promise<DecodedChunk>;
    close(): void;
}
/** Decodes where it is called. */
export declare class InlineService implements ChunkService {
    private readonly decoder;
    constructor(index: DecoderIndex, kernels: KernelsMaker);
    addCodebook(codebook: number, kind: number, payload: Uint8Array): void;
    decode(task: DecodeTask): Promise<DecodedChunk>;
    /** Decode without a promise, as a worker does. */
    decodeNow({ payloads, rows, needs, degree, format, ranges }: DecodeTask): DecodedChunk;
    close(): void;
}
/** Decodes where it is called, a chunk in a task of its own, so that the page stays awake where it may start no workers. */
export declare class SlicedService extends InlineService {
    private last;
    decode(task: DecodeTask): Promise<DecodedChunk>;
}
