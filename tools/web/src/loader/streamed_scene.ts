import { checkPicture, type Description, type PictureName, readDescription } from "../container/description.js";
import { fileBeginning, isManifest, PREAMBLE_BYTES, readPreamble } from "../container/preamble.js";
import type { SceneInfo } from "../container/root.js";
import { type Page, SceneIndex, type ScenePlaces } from "../container/scene_index.js";
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
import { type FetchSource, isDamaged } from "./scene_fetch.js";
import { SceneStream } from "./scene_stream.js";
import { bytesPerSplat, type ChunkUpdate, type StreamOptions } from "./stream_options.js";

/** Bytes of the first request, which always contain the root (SPEC 8.1). */
const FIRST_BYTES = 65_536;

/** Reason codes of a root whose bytes were damaged on the way. */
const DAMAGED_ROOT: ReadonlySet<string> = new Set(["preamble-crc", "root-crc", "places-crc"]);

/** Options of `StreamedScene.open`. */
export interface OpenOptions {
  readonly signal?: AbortSignal;
  readonly http?: HttpOptions;
  readonly retry?: Partial<RetryOptions>;
  /** Decoded bytes of a stream at most (SPEC 9.2); by default 64 MiB and 256 for each byte of the file. */
  readonly maxDecodedBytes?: number;
  /**
   * Makes the decoder of the chunks, for example a pool of workers; by default chunks are decoded on the caller's
   * thread.
   */
  readonly service?: (index: DecoderIndex) => ChunkService | Promise<ChunkService>;
  /** Reader of scenes stored as folders: `folders` of `cogsplat/folders`. */
  readonly folders?: FolderReader;
}

/** Locates the segments of a scene stored as a folder of a manifest and objects (SPEC 3.4). */
export interface FolderReader {
  /**
   * Read the addresses of the segments.
   *
   * @param manifest - Source of the manifest; objects are relative to it.
   * @param beginning - The manifest, its length if known, and whether its server answers ranges.
   * @param index - Index with the root alone.
   */
  open(
    manifest: ByteSource,
    beginning: { readonly available: Uint8Array; readonly length: number | undefined; readonly hasRanges: boolean },
    index: SceneIndex,
  ): { readonly places: ScenePlaces; readonly source: ByteSource };
}

/** A scene streamed from the URL of a file or folder, from a File, or from another source of bytes. */
export class StreamedScene implements FetchSource {
  /** The last page being read; pages are read one after the other, once for all streams. */
  private pages: Promise<unknown> = Promise.resolve();
  /** Layers of compensation received by streams with `compensate`. */
  readonly compensation: PrefixCompensation;
  /** Load the kernels, for segments that belong to no chunk. */
  readonly loadKernels = loadKernels;

  private constructor(
    readonly index: SceneIndex,
    /** Byte ranges of segments and pages in the source of `reader`. */
    readonly places: ScenePlaces,
    readonly reader: RetryingReader,
    /** First bytes of the file. */
    readonly beginning: Beginning,
    private readonly source: string | URL | Blob | ByteSource,
    private readonly options: OpenOptions,
    /** Whether this scene replaced one that had changed. */
    private readonly isReopened = false,
  ) {
    this.compensation = new PrefixCompensation(index);
  }

  /**
   * Request the first bytes of a scene and read its root.
   *
   * @param source - URL of a file; with `options.folders` URL of a manifest, or of its folder with a slash at the end
   * (SPEC 3.4); a File, a Blob, or another source of bytes.
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
      // A cache may hold damaged bytes, so the server is asked once more.
      return StreamedScene.begin(source, { ...options, http: { ...options.http, fresh: true } }, false);
    }
  }

  /**
   * Open the same source again, bypassing caches, after it changed while it was read (SPEC 8.8).
   *
   * @param signal - Aborts the request.
   * @throws CogsplatError `source-changed` where this scene was itself reopened, so that a file that keeps changing
   *   ends.
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
    try {
      await beginning.waitFor(PREAMBLE_BYTES, options.signal);
      return isManifest(beginning.available)
        ? await StreamedScene.beginFolder(given, beginning, source, options, isReopened)
        : await StreamedScene.beginFile(reader, beginning, source, options, isReopened);
    } catch (error) {
      // The rest of a refused file is not received.
      beginning.stop();
      throw error;
    }
  }

  /** Read the root of a file from its first bytes. */
  private static async beginFile(
    reader: RetryingReader,
    beginning: Beginning,
    source: string | URL | Blob | ByteSource,
    options: OpenOptions,
    isReopened: boolean,
  ): Promise<StreamedScene> {
    // Other files are refused by their first bytes.
    const { rootLength } = readPreamble(beginning.available);
    // Where the source does not state the file's length, its end does.
    await beginning.waitFor(beginning.total === undefined ? FIRST_BYTES : PREAMBLE_BYTES + rootLength, options.signal);
    const { available, total } = beginning;
    const index = SceneIndex.open(
      available.slice(),
      total ?? (available.length < FIRST_BYTES ? available.length : undefined),
    );
    return new StreamedScene(index, index, reader, beginning, source, options, isReopened);
  }

  /** Read the root of a folder from the first bytes of its manifest (SPEC 3.4). */
  private static async beginFolder(
    manifest: ByteSource,
    beginning: Beginning,
    source: string | URL | Blob | ByteSource,
    options: OpenOptions,
    isReopened: boolean,
  ): Promise<StreamedScene> {
    if (options.folders === undefined)
      throw new SourceError("a scene stored as a folder needs the option `folders`", undefined, false);
    // The first 64 KiB contain the whole manifest (SPEC 3.4).
    await beginning.waitFor(FIRST_BYTES, options.signal);
    const { available, total, sequential } = beginning;
    const index = SceneIndex.begin(fileBeginning(available));
    const length = total ?? (available.length < FIRST_BYTES ? available.length : undefined);
    const { places, source: objects } = options.folders.open(
      manifest,
      { available, length, hasRanges: !sequential },
      index,
    );
    index.checkRoot();
    const reader = new RetryingReader(objects, { ...DEFAULT_RETRY, ...options.retry });
    return new StreamedScene(index, places, reader, beginning, source, options, isReopened);
  }

  /** Whether the scene is stored as a folder of a manifest and objects (SPEC 3.4). */
  get isFolder(): boolean {
    return this.places !== this.index;
  }

  /** Whether range requests are answered; a server that ignores ranges sends the whole file in order. */
  get answersRanges(): boolean {
    return this.isFolder || !this.beginning.sequential;
  }

  /** Contents of the root about the scene. */
  get info(): SceneInfo {
    return this.index.scene;
  }

  /**
   * Fetch and decode chunks until the scene is complete.
   *
   * The order is that of the file, which shows most for its bytes, or that of `priority`. A chunk is yielded when its
   * head has arrived, and again with its refinement or its tail.
   */
  async *stream(options: StreamOptions = {}): AsyncGenerator<ChunkUpdate, void, undefined> {
    this.checkSize(options);
    yield* new SceneStream(this, await this.makeService(), options).changes();
  }

  /**
   * Fetch the description of the scene: texts, views, annotations (SPEC 5.13).
   *
   * @returns undefined where the scene has none.
   *
   * @example
   * ```ts
   * heading.textContent = (await scene.description())?.title ?? "Untitled";
   * ```
   */
  async description(signal?: AbortSignal): Promise<Description | undefined> {
    const segment = this.index.description;
    return segment === undefined ? undefined : readDescription(await this.readSegment(segment, signal));
  }

  /**
   * Fetch a picture of the description, and check its header before any decoder sees it (SPEC 5.14).
   *
   * @returns The picture as a Blob with its media type; undefined where the scene has none.
   */
  async picture(name: PictureName, signal?: AbortSignal): Promise<Blob | undefined> {
    const stated = (await this.description(signal))?.[name];
    if (stated === undefined) return undefined;
    const page = this.index.picturesPage;
    if (page !== undefined) await this.readPage(() => page);
    const segment = this.index.pictures.get(name);
    if (segment === undefined) throw new CogsplatError("description-segments", `the file has no ${name}`);
    const bytes = await this.readSegment(segment, signal);
    checkPicture(stated, bytes);
    return new Blob([bytes], { type: stated.type });
  }

  /** Read a segment of an available index; one with a wrong CRC is fetched once more, bypassing caches. */
  private async readSegment(segment: number, signal: AbortSignal | undefined): Promise<Uint8Array<ArrayBuffer>> {
    const place = this.places.range(segment);
    const end = place.offset + place.length;
    const isHere = this.beginning.holds(end);
    if (isHere) await this.beginning.waitFor(end, signal);
    const read = async (fresh: boolean): Promise<Uint8Array<ArrayBuffer>> =>
      new Uint8Array(await this.reader.readAll(place, signal, fresh));
    const bytes = isHere ? this.beginning.available.slice(place.offset, end) : await read(false);
    try {
      this.index.checkCrc(segment, bytes);
      return bytes;
    } catch {
      const again = await read(true);
      this.index.checkCrc(segment, again);
      return again;
    }
  }

  /** Make the decoder of one stream; the caller closes it. */
  async makeService(): Promise<ChunkService> {
    const { index, options } = this;
    return (options.service ?? inlineService)({ scene: index.scene, codebooks: index.codebooks });
  }

  /** Refuse a scene whose rows and codebooks exceed the caller's memory limit, before anything is fetched. */
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

  /** Read the first unread page of the file. */
  async readNextPage(): Promise<void> {
    await this.readPage(() => this.index.nextPage());
  }

  /**
   * Read a page unless it was read.
   *
   * @param choose - Returns the page, once all pages asked for before are read.
   */
  private async readPage(choose: () => Page | undefined): Promise<void> {
    const read = async (): Promise<void> => {
      const page = choose();
      if (page === undefined || this.index.isRead(page)) return;
      const place = this.places.pageRange(page);
      const end = place.offset + place.length;
      const isHere = this.beginning.holds(end);
      if (isHere) await this.beginning.waitFor(end, undefined);
      const bytes = isHere
        ? this.beginning.available.slice(place.offset, end)
        : await this.reader.readAll(place, undefined);
      try {
        this.places.addPage(page, bytes);
      } catch (error) {
        if (!isDamaged(error)) throw error;
        // One with a wrong CRC is fetched once more, bypassing caches.
        this.places.addPage(page, await this.reader.readAll(place, undefined, true));
      }
    };
    // A page that failed for one caller is read again for the next.
    this.pages = this.pages.then(read, read);
    await this.pages;
  }
}

async function inlineService(index: DecoderIndex): Promise<ChunkService> {
  return new InlineService(index, await loadKernels());
}

/**
 * Return the address of the manifest for a folder's URL, which ends in a slash (SPEC 3.4), and any other URL unchanged.
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

/** Return the source of bytes for an argument of `StreamedScene.open`. */
export function sourceOf(source: string | URL | Blob | ByteSource, http?: HttpOptions): ByteSource {
  if (typeof source === "string" || source instanceof URL) return new HttpSource(manifestAddress(String(source)), http);
  return source instanceof Blob ? new BlobSource(source) : source;
}
