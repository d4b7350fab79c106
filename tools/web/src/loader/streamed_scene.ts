import type { SceneInfo } from "../container/root.js";
import { SceneIndex } from "../container/scene_index.js";
import { PREAMBLE_BYTES, readPreamble } from "../container/preamble.js";
import { CogsplatError } from "../errors.js";
import { loadKernels } from "../kernels/load.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import { shnFloats } from "../scene/chunk_tail.js";
import { PrefixCompensation } from "../scene/prefix_compensation.js";
import { defaultLimit } from "../scene/scene_file.js";
import { InlineService, type ChunkService } from "../workers/decode_task.js";
import { Beginning } from "./beginning.js";
import { BlobSource, type ByteSource } from "./byte_source.js";
import { HttpSource, type HttpOptions } from "./http_source.js";
import { DEFAULT_RETRY, type RetryOptions } from "./retry.js";
import { RetryingReader } from "./retrying_reader.js";
import { SceneStream } from "./scene_stream.js";
import { bytesPerSplat, type ChunkUpdate, type StreamOptions } from "./stream_options.js";

/** Bytes of the first request; they always hold the root (SPEC 8.1). */
const FIRST_BYTES = 65_536;

/** Reason codes of a beginning whose bytes are not those that were written. */
const DAMAGED_ROOT: ReadonlySet<string> = new Set(["preamble-crc", "root-crc"]);

/** How a scene is opened. */
export interface OpenOptions {
  readonly signal?: AbortSignal;
  readonly http?: HttpOptions;
  readonly retry?: Partial<RetryOptions>;
  /** Most decoded bytes of a stream (SPEC 9.2); by default 64 MiB and 256 for each byte of the file. */
  readonly maxDecodedBytes?: number;
  /** Makes what decodes the chunks, such as a pool of workers; by default they are decoded where the caller runs. */
  readonly service?: (index: DecoderIndex) => ChunkService | Promise<ChunkService>;
}

/** A scene that is read from a URL, a file or another source of bytes while it is drawn. */
export class StreamedScene {
  /** The last page that is being read; pages are read one after the other, once for all streams. */
  private pages: Promise<unknown> = Promise.resolve();
  /** Layers of compensation, as far as a stream with `compensate` has brought them. */
  readonly compensation: PrefixCompensation;

  private constructor(
    readonly index: SceneIndex,
    private readonly reader: RetryingReader,
    /** What the first request brings. */
    private readonly beginning: Beginning,
    private readonly source: string | URL | Blob | ByteSource,
    private readonly options: OpenOptions,
    /** Whether this scene took the place of one that had changed. */
    private readonly isReopened = false,
  ) {
    this.compensation = new PrefixCompensation(index);
  }

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
  static async open(source: string | URL | Blob | ByteSource, options: OpenOptions = {}): Promise<StreamedScene> {
    try {
      return await StreamedScene.begin(source, options, false);
    } catch (error) {
      const isDamaged = error instanceof CogsplatError && DAMAGED_ROOT.has(error.code);
      if (!isDamaged || (typeof source !== "string" && !(source instanceof URL))) throw error;
      // A cache may hold damaged bytes; those of the server are asked for, once.
      return StreamedScene.begin(source, { ...options, http: { ...options.http, fresh: true } }, false);
    }
  }

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
  async reopen(signal?: AbortSignal): Promise<StreamedScene> {
    if (this.isReopened) throw new CogsplatError("source-changed", "the source changed again after it was opened anew");
    const http = { ...this.options.http, fresh: true };
    const { signal: _signal, ...options } = this.options;
    return StreamedScene.begin(this.source, { ...options, http, ...(signal && { signal }) }, true);
  }

  private static async begin(
    source: string | URL | Blob | ByteSource, options: OpenOptions, isReopened: boolean,
  ): Promise<StreamedScene> {
    const reader = new RetryingReader(sourceOf(source, options.http), { ...DEFAULT_RETRY, ...options.retry });
    const beginning = new Beginning(reader, FIRST_BYTES);
    await beginning.upTo(PREAMBLE_BYTES, options.signal);
    // What is no COGS file is refused by its first bytes.
    const { rootLength } = readPreamble(beginning.here);
    // A source that does not say how long the file is does so by ending.
    await beginning.upTo(beginning.total === undefined ? FIRST_BYTES : PREAMBLE_BYTES + rootLength, options.signal);
    const { here, total } = beginning;
    const index = SceneIndex.open(here.slice(), total ?? (here.length < FIRST_BYTES ? here.length : undefined));
    index.settle();
    return new StreamedScene(index, reader, beginning, source, options, isReopened);
  }

  /** What the root says of the scene. */
  get info(): SceneInfo {
    return this.index.scene;
  }

  /**
   * Fetch, decode and hand over chunks until all are there.
   *
   * The order is that of the file, which shows most for its bytes, or that of `priority`. A chunk is given as soon as
   * its head is there, and given again when its refinement or its tail has come.
   */
  async *stream(options: StreamOptions = {}): AsyncGenerator<ChunkUpdate, void, undefined> {
    this.checkSize(options);
    const makeService = this.options.service ?? inlineService;
    const service = await makeService({ scene: this.index.scene, codebooks: this.index.codebooks });
    const source = {
      index: this.index,
      reader: this.reader,
      beginning: this.beginning,
      compensation: this.compensation,
      kernels: options.order && (await loadKernels())(),
      readPages: (count: number) => this.readPages(count),
    };
    const stream = new SceneStream(source, service, options);
    try {
      yield* stream.updates();
    } finally {
      stream.stop();
      service.close();
    }
  }

  /** Refuse a scene whose rows and codebooks take more memory than the caller allows, before anything is fetched. */
  private checkSize({ degree = 3, memoryBudget = Infinity, splatBudget = Infinity }: StreamOptions): void {
    const { scene, codebooks, fileLength } = this.index;
    const used = Math.min(degree, scene.shDegree);
    const rows = Math.min(Math.min(scene.splats, splatBudget) * bytesPerSplat("splats", used), memoryBudget);
    const books = codebooks.reduce((sum, book) => sum + 4 * book.rows * (book.attribute === "shape" ? 7 : shnFloats(used)), 0);
    const most = this.options.maxDecodedBytes ?? defaultLimit(fileLength);
    if (rows + books > most) throw new CogsplatError("decoded-size", `${rows + books} decoded bytes, at most ${most}`);
  }

  /** Read index pages until so many are known. */
  private async readPages(count: number): Promise<void> {
    const read = async (): Promise<void> => {
      for (let page = this.index.nextPage(); page && this.index.pagesRead < count; page = this.index.nextPage()) {
        const end = page.offset + page.length;
        const isHere = this.beginning.holds(end);
        if (isHere) await this.beginning.upTo(end, undefined);
        this.index.addPage(isHere ? this.beginning.here.slice(page.offset, end) : await this.reader.all(page, undefined));
        this.index.settle();
      }
    };
    // A page that failed for one caller is tried again for the next.
    this.pages = this.pages.then(read, read);
    await this.pages;
  }
}

async function inlineService(index: DecoderIndex): Promise<ChunkService> {
  return new InlineService(index, await loadKernels());
}

/** What a scene is read from. */
export function sourceOf(source: string | URL | Blob | ByteSource, http?: HttpOptions): ByteSource {
  if (typeof source === "string" || source instanceof URL) return new HttpSource(source, http);
  return source instanceof Blob ? new BlobSource(source) : source;
}
