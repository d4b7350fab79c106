import type { SceneInfo } from "../container/root.js";
import { SceneIndex } from "../container/scene_index.js";
import { PREAMBLE_BYTES, readPreamble } from "../container/preamble.js";
import { loadKernels } from "../kernels/load.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import { PrefixCompensation } from "../scene/prefix_compensation.js";
import { InlineService, type ChunkService } from "../workers/decode_task.js";
import { Beginning } from "./beginning.js";
import { BlobSource, type ByteSource } from "./byte_source.js";
import { HttpSource, type HttpOptions } from "./http_source.js";
import { DEFAULT_RETRY, type RetryOptions } from "./retry.js";
import { RetryingReader } from "./retrying_reader.js";
import { SceneStream } from "./scene_stream.js";
import type { ChunkUpdate, StreamOptions } from "./stream_options.js";

/** Bytes of the first request; they always hold the root (SPEC 8.1). */
const FIRST_BYTES = 65_536;

/** How a scene is opened. */
export interface OpenOptions {
  readonly signal?: AbortSignal;
  readonly http?: HttpOptions;
  readonly retry?: Partial<RetryOptions>;
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
    private readonly service: OpenOptions["service"],
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
    return new StreamedScene(index, reader, beginning, options.service);
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
    const makeService = this.service ?? inlineService;
    const service = await makeService({ scene: this.index.scene, codebooks: this.index.codebooks });
    const source = {
      index: this.index,
      reader: this.reader,
      beginning: this.beginning,
      compensation: this.compensation,
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
