import type { SceneInfo } from "../container/root.js";
import { SceneIndex, type ScenePlaces } from "../container/scene_index.js";
import { loadKernels } from "../kernels/load.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import { PrefixCompensation } from "../scene/prefix_compensation.js";
import { type ChunkService } from "../workers/decode_task.js";
import { Beginning } from "./beginning.js";
import { type ByteSource } from "./byte_source.js";
import { type HttpOptions } from "./http_source.js";
import { type RetryOptions } from "./retry.js";
import { RetryingReader } from "./retrying_reader.js";
import { type StreamSource } from "./scene_stream.js";
import { type ChunkUpdate, type StreamOptions } from "./stream_options.js";
/** How a scene is opened. */
export interface OpenOptions {
    readonly signal?: AbortSignal;
    readonly http?: HttpOptions;
    readonly retry?: Partial<RetryOptions>;
    /** Most decoded bytes of a stream (SPEC 9.2); by default 64 MiB and 256 for each byte of the file. */
    readonly maxDecodedBytes?: number;
    /** Makes what decodes the chunks, such as a pool of workers; by default they are decoded where the caller runs. */
    readonly service?: (index: DecoderIndex) => ChunkService | Promise<ChunkService>;
    /** Reads scenes that are kept as folders: `folders` of `cogsplat/folders`. */
    readonly folders?: FolderReader;
}
/** Finds the segments of a scene that is kept as a folder of a manifest and objects (SPEC 3.4). */
export interface FolderReader {
    /**
     * Read where the segments are.
     *
     * @param manifest - From which the objects are reached.
     * @param beginning - First bytes of the manifest, its length where it is known, and whether its server answers ranges.
     * @param index - The root.
     */
    open(manifest: ByteSource, beginning: {
        readonly here: Uint8Array;
        readonly length: number | undefined;
        readonly hasRanges: boolean;
    }, index: SceneIndex): {
        readonly places: ScenePlaces;
        readonly source: ByteSource;
    };
}
/** A scene that is read from the URL of a file or a folder, a file or another source of bytes while it is drawn. */
export declare class StreamedScene implements StreamSource {
    readonly index: SceneIndex;
    /** Where segments and pages are in what `reader` reads. */
    readonly places: ScenePlaces;
    readonly reader: RetryingReader;
    /** What the first request brings. */
    readonly beginning: Beginning;
    private readonly source;
    private readonly options;
    /** Whether this scene took the place of one that had changed. */
    private readonly isReopened;
    /** The last page that is being read; pages are read one after the other, once for all streams. */
    private pages;
    /** Layers of compensation, as far as a stream with `compensate` has brought them. */
    readonly compensation: PrefixCompensation;
    /** For what reads segments that are no part of chunks. */
    readonly loadKernels: typeof loadKernels;
    private constructor();
    /**
     * Ask for the beginning of a file and read its root.
     *
     * @param source - A URL, of a file or, with `options.folders`, of a manifest, or of a folder where it ends in a slash (SPEC 3.4); a File
     * or Blob, or any source of bytes.
     *
     * @example
     * ```ts
     * const scene = await StreamedScene.open("https://example.org/garden.cogs");
     * for await (const update of scene.stream({ format: "packed" })) draw(update);
     * ```
     */
    static open(source: string | URL | Blob | ByteSource, options?: OpenOptions): Promise<StreamedScene>;
    /**
     * Open the same source again, around caches, because it changed while it was read (SPEC 8.8).
     *
     * @param signal - Ends the request.
     * @throws CogsplatError `source-changed` where this scene was itself opened again: a file that changes all the time is
     * not read for ever.
     *
     * @example
     * ```ts
     * try {
     *   await show(scene);
     * } catch (error) {
     *   if (!(error instanceof CogsplatError) || error.code !== "source-changed") throw error;
     *   await show(await scene.reopen());
     * }
     * ```
     */
    reopen(signal?: AbortSignal): Promise<StreamedScene>;
    private static begin;
    /** Read the root of a folder from the beginning of its manifest (SPEC 3.4). */
    private static beginFolder;
    /** Whether the scene is kept as a folder of a manifest and objects (SPEC 3.4). */
    get isFolder(): boolean;
    /** Whether parts of the scene can be asked for; from a server that ignores ranges they come as they stand in the file. */
    get answersRanges(): boolean;
    /** What the root says of the scene. */
    get info(): SceneInfo;
    /**
     * Fetch, decode and hand over chunks until all are there.
     *
     * The order is that of the file, which shows most for its bytes, or that of `priority`. A chunk is given as soon as
     * its head is there, and given again when its refinement or its tail has come.
     */
    stream(options?: StreamOptions): AsyncGenerator<ChunkUpdate, void, undefined>;
    /** What decodes the chunks of one run through the scene; who asks for it closes it. */
    makeService(): Promise<ChunkService>;
    /** Refuse a scene whose rows and codebooks take more memory than the caller allows, before anything is fetched. */
    checkSize({ degree, memoryBudget, splatBudget }: Pick<StreamOptions, "degree" | "memoryBudget" | "splatBudget">): void;
    /** Take a page; one whose CRC does not match is asked for once more, around caches. */
    private addPage;
    /** Read index pages until so many are known. */
    readPages(count: number): Promise<void>;
}
/**
 * The address of a folder's manifest where a URL ends in a slash (SPEC 3.4); else the URL.
 *
 * @example
 * ```ts
 * manifestAddress("https://example.org/scene/?v=2"); // "https://example.org/scene/manifest.cogsm?v=2"
 * ```
 */
export declare function manifestAddress(url: string): string;
/** What a scene is read from. */
export declare function sourceOf(source: string | URL | Blob | ByteSource, http?: HttpOptions): ByteSource;
