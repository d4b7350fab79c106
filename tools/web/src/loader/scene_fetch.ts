import type { ByteRange, SceneIndex, ScenePlaces } from "../container/scene_index.js";
import { SegmentKind } from "../container/tables.js";
import { CogsplatError, SourceError } from "../errors.js";
import { DEFAULT_RANGES } from "../scene/packed_splats.js";
import type { PrefixCompensation } from "../scene/prefix_compensation.js";
import type { ChunkService } from "../workers/decode_task.js";
import type { Beginning } from "./beginning.js";
import { ChunkQueue } from "./chunk_queue.js";
import type { RetryingReader } from "./retrying_reader.js";
import { SegmentRequests } from "./segment_requests.js";
import type { ChunkUpdate, StreamOptions } from "./stream_options.js";

/** Changes that may queue for the caller before no more is requested. */
const MAX_QUEUED = 64;
/** Longest time in which segments of the first bytes are accepted at once, ms: a frame of the page has 16. */
const SLICE_MILLISECONDS = 4;
/** Requests in a row that fail after all retries, without a segment between them, until the fetch ends. */
const MAX_LOST_REQUESTS = 6;
/** Bytes of decoded heads kept until their tails arrive, at most: two million packed splats. */
export const MOST_KEPT_BYTES = 32 * 2 ** 20;

/** Reason codes of segments, pages and their places that were damaged on the way. */
const DAMAGE: ReadonlySet<string> = new Set(["segment-crc", "page-crc", "places-crc"]);

/** Return whether bytes were damaged on the way, so that fetching them again may help; nothing of them is entered. */
export function isDamaged(error: unknown): boolean {
  return error instanceof CogsplatError && DAMAGE.has(error.code);
}

/** Rows of a decoded chunk. */
export type ChunkRows = Omit<ChunkUpdate, "prefix">;

/** A scene as fetches read it; shared by all fetches of the scene. */
export interface FetchSource {
  readonly index: SceneIndex;
  /** Byte ranges of segments in the source of `reader`. */
  readonly places: ScenePlaces;
  /** Whether the server answers range requests; otherwise each answer is the whole file. */
  readonly answersRanges: boolean;
  readonly reader: RetryingReader;
  /** First bytes of the file, as they arrive. */
  readonly beginning: Beginning;
  readonly compensation: PrefixCompensation;
  /** Read the first unread page of the file. */
  readNextPage(): Promise<void>;
}

/**
 * One pass through a scene: reads pages; requests, checks and decodes segments; reports damage.
 *
 * Where a page is requested like a segment, −1 − n stands for page n of `SceneIndex.pages`. Subclasses choose which segments to request next, and turn decoded chunks into changes for the caller.
 */
export abstract class SceneFetch<Change> {
  protected readonly index: SceneIndex;
  /** SH degree decoded. */
  protected readonly degree: number;
  protected readonly queue: ChunkQueue;
  protected readonly requests: SegmentRequests;
  /** Segments on their way without a request that can be stopped: in the first bytes, or fetched again around caches. */
  protected readonly uncancellable = new Set<number>();
  private readonly changesQueued: Change[] = [];
  private readonly abort = new AbortController();
  private isChoosing = false;
  /** Requests that have failed since the last segment. */
  private lostRequests = 0;
  private failure: { readonly error: unknown } | undefined;
  private wake: () => void = () => undefined;

  protected constructor(
    protected readonly source: FetchSource,
    private readonly service: ChunkService,
    protected readonly options: StreamOptions,
  ) {
    const { index, reader } = source;
    const { format = "splats", ranges, level } = options;
    this.index = index;
    this.degree = Math.min(options.degree ?? index.scene.shDegree, index.scene.shDegree);
    this.queue = new ChunkQueue(
      index,
      service,
      { degree: this.degree, format, ranges: { ...DEFAULT_RANGES, ...ranges }, refine: true, level },
      (rows) => this.onDecoded(rows),
      (error, chunk) => {
        this.onUndecodable(chunk);
        this.reportDamage(error, [chunk]);
      },
    );
    this.requests = new SegmentRequests(reader, this.rangeOf, {
      received: (segment, payload) => this.accept(segment, payload),
      failed: (error, segments) => this.abandon(error, segments),
      ended: () => this.chooseSoon(),
    });
  }

  /** Enter chunks whose page has become known. */
  protected abstract onPage(): void;

  /**
   * Request segments.
   *
   * @param hasRoom - Whether the caller keeps up with the changes.
   */
  protected abstract choose(hasRoom: boolean): void;

  /** Whether segments or pages are still to be requested. */
  protected abstract get hasMore(): boolean;

  /** Queue the changes that follow from a decoded chunk. */
  protected abstract onDecoded(rows: ChunkRows): void;

  /** Called when a segment cannot be fetched. */
  protected onLost(_segment: number): void {
    // A fetch whose order does not depend on the segment needs no action.
  }

  /** Called when a chunk cannot be decoded. */
  protected onUndecodable(_chunk: number): void {
    // A fetch whose order does not depend on the chunk needs no action.
  }

  /** Yield changes until the scene is complete. */
  async *changes(): AsyncGenerator<Change, void, undefined> {
    const { signal } = this.options;
    const onAbort = (): void => {
      this.abort.abort(signal!.reason);
      this.wake();
    };
    signal?.addEventListener("abort", onAbort);
    try {
      void this.readPages();
      this.onPage();
      this.chooseSoon();
      for (;;) {
        signal?.throwIfAborted();
        const change = this.changesQueued.shift();
        if (change !== undefined) {
          yield change;
          if (this.changesQueued.length === MAX_QUEUED - 1) this.chooseSoon();
          continue;
        }
        if (this.failure !== undefined) throw this.failure.error;
        if (this.isComplete) return;
        await new Promise<void>((resolve) => {
          this.wake = resolve;
        });
      }
    } finally {
      signal?.removeEventListener("abort", onAbort);
      this.abort.abort();
      this.requests.close();
      this.source.beginning.release();
      this.onEnd();
      this.service.close();
    }
  }

  /** Release what a subclass holds. */
  protected onEnd(): void {
    // Most hold nothing.
  }

  /** Whether all segments have arrived and all chunks are decoded. */
  protected get isComplete(): boolean {
    return !this.hasMore && this.isIdle;
  }

  /** Whether nothing is in flight and nothing is being decoded. */
  protected get isIdle(): boolean {
    return this.requests.count === 0 && this.uncancellable.size === 0 && this.queue.idle;
  }

  protected readonly rangeOf = (segment: number): ByteRange => {
    const page = this.index.pages[-1 - segment];
    return page === undefined ? this.source.places.range(segment) : this.source.places.pageRange(page);
  };

  /** Queue a change for the caller. */
  protected push(change: Change): void {
    this.changesQueued.push(change);
    this.wake();
  }

  /** Call `choose` once the events of this moment are handled. */
  protected chooseSoon(): void {
    if (this.isChoosing) return;
    this.isChoosing = true;
    queueMicrotask(() => {
      this.isChoosing = false;
      if (this.abort.signal.aborted || this.failure !== undefined) return;
      try {
        this.choose(this.changesQueued.length < MAX_QUEUED);
      } catch (error) {
        this.fail(error);
      }
      if (this.isComplete) this.wake();
    });
  }

  /** End with an error, after the changes that are queued. */
  protected fail(error: unknown): void {
    this.failure ??= { error };
    this.wake();
  }

  /** Read the pages in the order of the file, and enter the chunks of each. */
  protected async readPages(): Promise<void> {
    try {
      while (!this.index.complete) {
        this.abort.signal.throwIfAborted();
        await this.source.readNextPage();
        this.onPage();
        this.chooseSoon();
      }
      this.chooseSoon();
    } catch (error) {
      this.fail(error);
    }
  }

  /** Accept the segments within the first bytes of the file; return the remaining segments. */
  protected acceptFromBeginning(segments: readonly number[]): number[] {
    const { beginning } = this.source;
    const held = new Set(segments.filter((segment) => this.isInBeginning(segment)));
    const isHere = (segment: number): boolean => this.endOf(segment) <= beginning.available.length;
    const here = [...held].filter(isHere);
    const coming = [...held].filter((segment) => !isHere(segment)).sort((a, b) => this.endOf(a) - this.endOf(b));
    void this.acceptInSlices([...here, ...coming]);
    return segments.filter((segment) => !held.has(segment));
  }

  /** Return whether a segment, or page −1 − n, comes with the first request. */
  protected isInBeginning(segment: number): boolean {
    return this.source.beginning.holds(this.endOf(segment));
  }

  private endOf(segment: number): number {
    const { offset, length } = this.rangeOf(segment);
    return offset + length;
  }

  /** Accept segments of the first bytes in order, and yield to the page between time slices. */
  private async acceptInSlices(segments: readonly number[]): Promise<void> {
    const { beginning } = this.source;
    for (const segment of segments) this.uncancellable.add(segment);
    let slice = performance.now();
    for (const segment of segments) {
      const end = this.endOf(segment);
      try {
        if (beginning.available.length < end) {
          await beginning.waitFor(end, this.abort.signal);
          slice = performance.now();
        } else if (performance.now() - slice > SLICE_MILLISECONDS) {
          await new Promise((resolve) => setTimeout(resolve, 0));
          this.abort.signal.throwIfAborted();
          slice = performance.now();
        }
        if (beginning.available.length < end)
          throw new SourceError(`the file ends before byte ${end}`, undefined, true);
        // A segment that was evicted meanwhile is no longer expected.
        if (this.uncancellable.delete(segment)) {
          this.accept(segment, beginning.available.slice(this.rangeOf(segment).offset, end));
        }
      } catch (error) {
        if (this.uncancellable.delete(segment)) this.abandon(error, [segment]);
      }
      this.chooseSoon();
    }
  }

  /** Check the CRC of a segment and use it; a damaged one is fetched once more, around caches. */
  private accept(segment: number, payload: Uint8Array): void {
    try {
      this.check(segment, payload);
      this.use(segment, payload);
    } catch (error) {
      if (isDamaged(error)) void this.fetchAgain(segment);
      else this.abandon(error, [segment]);
    }
    this.chooseSoon();
  }

  private async fetchAgain(segment: number): Promise<void> {
    this.uncancellable.add(segment);
    try {
      const payload = await this.source.reader.readAll(this.rangeOf(segment), this.abort.signal, true);
      this.check(segment, payload);
      if (this.uncancellable.delete(segment)) this.use(segment, payload);
    } catch (error) {
      if (this.uncancellable.delete(segment)) this.abandon(error, [segment]);
    }
    this.chooseSoon();
  }

  /** Refuse a payload whose CRC does not match. */
  protected check(segment: number, payload: Uint8Array): void {
    this.index.checkCrc(segment, payload);
  }

  /** Use the payload of a segment whose CRC was checked. */
  protected use(segment: number, payload: Uint8Array): void {
    this.lostRequests = 0;
    const { kind, owner } = this.index.segments;
    if (kind[segment] === SegmentKind.compensation) this.source.compensation.add(owner[segment]!, payload);
    else this.queue.add(segment, payload);
  }

  /** Continue without segments that cannot be fetched; end after an error of the whole source. */
  protected abandon(error: unknown, segments: readonly number[]): void {
    if (this.abort.signal.aborted) return;
    const isOfSegment =
      error instanceof CogsplatError
        ? error.code !== "source-changed"
        : error instanceof SourceError && error.retryable;
    if (error instanceof SourceError) this.lostRequests++;
    if (!isOfSegment || this.lostRequests > MAX_LOST_REQUESTS) {
      this.fail(error);
      return;
    }
    for (const segment of segments) {
      this.requests.forget(segment);
      const chunks = this.queue.abandon(segment);
      this.onLost(segment);
      this.reportDamage(error, chunks);
    }
  }

  /** Report an error to `onDamage`; without it the fetch ends with the error. */
  private reportDamage(error: unknown, chunks: readonly number[]): void {
    const { onDamage } = this.options;
    try {
      if (onDamage === undefined || !(error instanceof CogsplatError || error instanceof SourceError)) throw error;
      for (const chunk of chunks.length === 0 ? [undefined] : chunks) onDamage(error, chunk);
    } catch (failure) {
      // The error itself, or one of the caller's function.
      this.fail(failure);
    }
    this.chooseSoon();
  }
}
