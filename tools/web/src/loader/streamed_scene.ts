import { fileBeginning, isManifest, PREAMBLE_BYTES, readPreamble } from "../container/preamble.js";
import type { SceneInfo } from "../container/root.js";
import { type ByteRange, SceneIndex, type ScenePlaces } from "../container/scene_index.js";
import { CogsplatError, SourceError } from "../errors.js";
import { loadKernels } from "../kernels/load.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import { shnFloats } from "../scene/chunk_tail.js";
import { PrefixCompensation } from "../scene/prefix_compensation.js";
import { defaultLimit } from "../scene/scene_file.js";
import { type ChunkService, InlineService } from "../workers/decode_task.js";
import { Beginning } from "./beginning.js";
import { BlobSource, type ByteSource } from "./byte_source.js";
import { type HttpOptions, HttpSource } from "./http_source.js";
import { DEFAULT_RETRY, type RetryOptions } from "./retry.js";
import { RetryingReader } from "./retrying_reader.js";
import type { FetchSource } from "./scene_fetch.js";
import { SceneStream } from "./scene_stream.js";
import { bytesPerSplat, type ChunkUpdate, type StreamOptions } from "./stream_options.js";

/** Bytes of the first request; they always hold the root (SPEC 8.1). */
const FIRST_BYTES = 65_536;

/** Reason codes of a beginning whose bytes are not those that were written. */
const DAMAGED_ROOT: ReadonlySet<string> = new Set(["preamble-crc", "root-crc", "places-crc"]);

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
  open(
    manifest: ByteSource,
    beginning: { readonly here: Uint8Array; readonly length: number | undefined; readonly hasRanges: boolean },
    index: SceneIndex,
  ): { readonly places: ScenePlaces; readonly source: ByteSource };
}

/** A scene that is read from the URL of a file or a folder, a file or another source of bytes while it is drawn. */
export class StreamedScene implements FetchSource {
  /** The last page that is being read; pages are read one after the other, once for all streams. */
  private pages: Promise<unknown> = Promise.resolve();
  /** Layers of compensation, as far as a stream with `compensate` has brought them. */
  readonly compensation: PrefixCompensation;
  /** For what reads segments that are no part of chunks. */
  readonly loadKernels = loadKernels;

  private constructor(
    readonly index: SceneIndex,
    /** Where segments and pages are in what `reader` reads. */
    readonly places: ScenePlaces,
    readonly reader: RetryingReader,
    /** What the first request brings. */
    readonly beginning: Beginning,
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
   * @param source - A URL, of a file or, with `options.folders`, of a manifest, or of a folder where it ends in a slash (SPEC 3.4); a File
   * or Blob, or any source of bytes.
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
    source: string | URL | Blob | ByteSource,
    options: OpenOptions,
    isReopened: boolean,
  ): Promise<StreamedScene> {
    const given = sourceOf(source, options.http);
    const reader = new RetryingReader(given, { ...DEFAULT_RETRY, ...options.retry });
    const beginning = new Beginning(reader, FIRST_BYTES);
    await beginning.upTo(PREAMBLE_BYTES, options.signal);
    if (isManifest(beginning.here)) return StreamedScene.beginFolder(given, beginning, source, options, isReopened);
    // What is no COGS file is refused by its first bytes.
    const { rootLength } = readPreamble(beginning.here);
    // A source that does not say how long the file is does so by ending.
    await beginning.upTo(beginning.total === undefined ? FIRST_BYTES : PREAMBLE_BYTES + rootLength, options.signal);
    const { here, total } = beginning;
    const index = SceneIndex.open(here.slice(), total ?? (here.length < FIRST_BYTES ? here.length : undefined));
    index.settle();
    return new StreamedScene(index, index, reader, beginning, source, options, isReopened);
  }

  /** Read the root of a folder from the beginning of its manifest (SPEC 3.4). */
  private static async beginFolder(
    manifest: ByteSource,
    beginning: Beginning,
    source: string | URL | Blob | ByteSource,
    options: OpenOptions,
    isReopened: boolean,
  ): Promise<StreamedScene> {
    if (options.folders === undefined)
      throw new SourceError("a scene that is kept as a folder, expected the option `folders`", undefined, false);
    // The root and its places lie in it (SPEC 8.8).
    await beginning.upTo(FIRST_BYTES, options.signal);
    const { here, total, sequential } = beginning;
    const index = SceneIndex.open(fileBeginning(here));
    const length = total ?? (here.length < FIRST_BYTES ? here.length : undefined);
    const { places, source: objects } = options.folders.open(manifest, { here, length, hasRanges: !sequential }, index);
    index.settle();
    const reader = new RetryingReader(objects, { ...DEFAULT_RETRY, ...options.retry });
    return new StreamedScene(index, places, reader, beginning, source, options, isReopened);
  }

  /** Whether the scene is kept as a folder of a manifest and objects (SPEC 3.4). */
  get isFolder(): boolean {
    return this.places !== this.index;
  }

  /** Whether parts of the scene can be asked for; from a server that ignores ranges they come as they stand in the file. */
  get answersRanges(): boolean {
    return this.isFolder || !this.beginning.sequential;
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
    yield* new SceneStream(this, await this.makeService(), options).changes();
  }

  /** What decodes the chunks of one run through the scene; who asks for it closes it. */
  async makeService(): Promise<ChunkService> {
    const { index, options } = this;
    return (options.service ?? inlineService)({ scene: index.scene, codebooks: index.codebooks });
  }

  /** Refuse a scene whose rows and codebooks take more memory than the caller allows, before anything is fetched. */
  checkSize({
    degree = 3,
    memoryBudget = Infinity,
    splatBudget = Infinity,
  }: Pick<StreamOptions, "degree" | "memoryBudget" | "splatBudget">): void {
    const { scene, codebooks, fileLength } = this.index;
    const used = Math.min(degree, scene.shDegree);
    const rows = Math.min(Math.min(scene.splats, splatBudget) * bytesPerSplat("splats", used), memoryBudget);
    const books = codebooks.reduce(
      (sum, book) => sum + 4 * book.rows * (book.attribute === "shape" ? 7 : shnFloats(used)),
      0,
    );
    const most = this.options.maxDecodedBytes ?? defaultLimit(fileLength);
    if (rows + books > most) throw new CogsplatError("decoded-size", `${rows + books} decoded bytes, at most ${most}`);
  }

  /** Take a page; one whose CRC does not match is asked for once more, around caches. */
  private async addPage(page: ByteRange, bytes: Uint8Array): Promise<void> {
    try {
      this.places.addPage(bytes);
    } catch (error) {
      if (!isDamagedPage(error)) throw error;
      this.places.addPage(await this.reader.all(page, undefined, true));
    }
  }

  /** Read index pages until so many are known. */
  async readPages(count: number): Promise<void> {
    const read = async (): Promise<void> => {
      for (let page = this.places.nextPage(); page && this.index.pagesRead < count; page = this.places.nextPage()) {
        const end = page.offset + page.length;
        const isHere = this.beginning.holds(end);
        if (isHere) await this.beginning.upTo(end, undefined);
        await this.addPage(
          page,
          isHere ? this.beginning.here.slice(page.offset, end) : await this.reader.all(page, undefined),
        );
        this.index.settle();
      }
    };
    // A page that failed for one caller is tried again for the next.
    this.pages = this.pages.then(read, read);
    await this.pages;
  }
}

/** A page or its places came damaged; nothing of it was taken. */
function isDamagedPage(error: unknown): boolean {
  return error instanceof CogsplatError && (error.code === "page-crc" || error.code === "places-crc");
}

async function inlineService(index: DecoderIndex): Promise<ChunkService> {
  return new InlineService(index, await loadKernels());
}

/**
 * The address of a folder's manifest where a URL ends in a slash (SPEC 3.4); else the URL.
 *
 * @example
 * ```ts
 * manifestAddress("https://example.org/scene/?v=2"); // "https://example.org/scene/manifest.cogsm?v=2"
 * ```
 */
export function manifestAddress(url: string): string {
  const [, path, rest] = /^([^?#]*)(.*)$/s.exec(url)!;
  return path!.endsWith("/") ? `${path}manifest.cogsm${rest}` : url;
}

/** What a scene is read from. */
export function sourceOf(source: string | URL | Blob | ByteSource, http?: HttpOptions): ByteSource {
  if (typeof source === "string" || source instanceof URL) return new HttpSource(manifestAddress(String(source)), http);
  return source instanceof Blob ? new BlobSource(source) : source;
}
