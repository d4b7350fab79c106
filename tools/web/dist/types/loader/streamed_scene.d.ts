import type { SceneInfo } from "../container/root.js";
import { SceneIndex } from "../container/scene_index.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import { PrefixCompensation } from "../scene/prefix_compensation.js";
import { type ChunkService } from "../workers/decode_task.js";
import { type ByteSource } from "./byte_source.js";
import { type HttpOptions } from "./http_source.js";
import { type RetryOptions } from "./retry.js";
import type { ChunkUpdate, StreamOptions } from "./stream_options.js";
/** How a scene is opened. */
export interface OpenOptions {
    readonly signal?: AbortSignal;
    readonly http?: HttpOptions;
    readonly retry?: Partial<RetryOptions>;
    /** Makes what decodes the chunks, such as a pool of workers; by default they are decoded where the caller runs. */
    readonly service?: (index: DecoderIndex) => ChunkService | Promise<ChunkService>;
}
/** A scene that is read from a URL, a file or another source of bytes while it is drawn. */
export declare class StreamedScene {
    readonly index: SceneIndex;
    private readonly reader;
    /** What the first request brings. */
    private readonly beginning;
    private readonly service;
    /** The last page that is being read; pages are read one after the other, once for all streams. */
    private pages;
    /** Layers of compensation, as far as a stream with `compensate` has brought them. */
    readonly compensation: PrefixCompensation;
    private constructor();
    /**
     * Ask for the beginning of a file and read its root.
     *
     * @param source - A URL, a File or Blob, or any source of bytes.
     *
     * @example
     * ```ts
     * const scene = await StreamedScene.open("https://example.org/garden.cogs");
     * for await (const update of scene.stream({ format: "packed" })) draw(update);
     * ```
     */
    static open(source: string | URL | Blob | ByteSource, options?: OpenOptions): Promise<StreamedScene>;
    /** What the root says of the scene. */
    get info(): SceneInfo;
    /**
     * Fetch, decode and hand over chunks until all are there.
     *
     * The order is that of the file, which shows most for its bytes, or that of `priority`. A chunk is given as soon as
     * its head is there, and given again when its refinement or its tail has come.
     */
    stream(options?: StreamOptions): AsyncGenerator<ChunkUpdate, void, undefined>;
    /** Read index pages until so many are known. */
    private readPages;
}
/** What a scene is read from. */
export declare function sourceOf(source: string | URL | Blob | ByteSource, http?: HttpOptions): ByteSource;
