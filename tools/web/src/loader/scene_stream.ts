import type { ByteRange, SceneIndex, ScenePlaces } from "../container/scene_index.js";
import { SegmentKind } from "../container/tables.js";
import { CogsplatError, SourceError } from "../errors.js";
import { DEFAULT_RANGES } from "../scene/packed_splats.js";
import type { PrefixCompensation } from "../scene/prefix_compensation.js";
import type { ChunkService } from "../workers/decode_task.js";
import type { Beginning } from "./beginning.js";
import { ChunkQueue } from "./chunk_queue.js";
import { nextRequest, RangeAssembler, type RangeRequest } from "./range_plan.js";
import type { RetryingReader } from "./retrying_reader.js";
import { bytesPerSplat, type ChunkInfo, type ChunkUpdate, type StreamOptions } from "./stream_options.js";

/** Most requests under way (SPEC 8.8). */
const MAX_REQUESTS = 6;
/** Bytes of the first request behind the beginning; each next one is twice as long, so that first chunks come soon. */
const FIRST_REQUEST = 262_144;
/** Updates that may wait for the caller before no more is fetched. */
const MAX_WAITING = 64;

/** Longest time in which segments of the first request are accepted at once, ms: a picture of the page has 16. */
const SLICE_MILLISECONDS = 4;

/** Most bytes of decoded heads that wait for their tails: those of two million packed splats. */
const MOST_KEPT_BYTES = 32 * 2 ** 20;

/** What a stream reads from; shared by all streams of a scene. */
export interface StreamSource {
  readonly index: SceneIndex;
  /** Where segments are in what is read. */
  readonly places: ScenePlaces;
  /** Whether parts can be asked for; else the source gives the whole file whatever it is asked for. */
  readonly answersRanges: boolean;
  readonly reader: RetryingReader;
  /** What the first request brings, as it comes. */
  readonly beginning: Beginning;
  readonly compensation: PrefixCompensation;
  /** Read index pages until so many are known. */
  readPages(count: number): Promise<void>;
}

/** One run through a scene: what is asked for, what has come, and what waits to be taken. */
export class SceneStream {
  private readonly index: SceneIndex;
  private readonly abort = new AbortController();
  private readonly queue: ChunkQueue;
  private readonly waiting: ChunkUpdate[] = [];
  /** Segments to ask for, in the order in which they are wanted. */
  private wanted: number[] = [];
  private readonly asked = new Set<number>();
  /** Chunks that were given, and how many of them from the first of the file on. */
  private readonly given = new Set<number>();
  /** Chunks that are not asked for because they end, or the level does not draw them. */
  private readonly leftOut = new Set<number>();
  private prefix = 0;
  private requests = 0;
  /** Segments that the first request is still to bring. */
  private waits = 0;
  private requestBytes = FIRST_REQUEST;
  private budget: number;
  private splatBudget: number;
  private plannedChunks = 0;
  private pagesDone = false;
  private failure: { readonly error: unknown } | undefined;
  private wake: () => void = () => undefined;
  private readonly degree: number;
  private readonly rowBytes: number;

  constructor(
    private readonly source: StreamSource,
    service: ChunkService,
    private readonly options: StreamOptions,
  ) {
    const { index } = source;
    this.index = index;
    const { level } = options;
    if (level !== undefined && !index.scene.levels[level]) throw new RangeError(`level ${level}`);
    this.degree = Math.min(options.degree ?? index.scene.shDegree, index.scene.shDegree);
    const format = options.format ?? "splats";
    this.rowBytes = bytesPerSplat(format, this.degree);
    this.budget = options.memoryBudget ?? Infinity;
    this.splatBudget = options.splatBudget ?? Infinity;
    const { signal } = options;
    if (signal?.aborted) this.abort.abort(signal.reason);
    else signal?.addEventListener("abort", this.onAbort);
    this.queue = new ChunkQueue(
      index,
      service,
      {
        degree: this.degree,
        format,
        ranges: { ...DEFAULT_RANGES, ...options.ranges },
        refine: true,
        level: options.level,
      },
      (update) => {
        this.given.add(update.chunk);
        while (this.given.has(this.prefix) || this.leftOut.has(this.prefix)) this.prefix++;
        this.waiting.push({ ...update, prefix: this.prefix });
        this.wake();
      },
      (error, chunk) => this.damage(error, [chunk]),
    );
  }

  /** Updates until every chunk has been given. */
  async *updates(): AsyncGenerator<ChunkUpdate, void, undefined> {
    void this.readPages();
    this.plan();
    for (;;) {
      this.abort.signal.throwIfAborted();
      const update = this.waiting.shift();
      if (update !== undefined) {
        yield update;
        continue;
      }
      if (this.failure !== undefined) throw this.failure.error;
      this.ask();
      if (this.done()) return;
      await new Promise<void>((resolve) => (this.wake = resolve));
    }
  }

  /** End all requests. */
  stop(): void {
    this.options.signal?.removeEventListener("abort", this.onAbort);
    this.abort.abort();
  }

  private readonly onAbort = (): void => {
    this.abort.abort(this.options.signal!.reason);
    this.wake();
  };

  private done(): boolean {
    return (
      this.pagesDone &&
      this.wanted.length === 0 &&
      this.requests === 0 &&
      this.waits === 0 &&
      this.queue.idle &&
      this.waiting.length === 0
    );
  }

  private stopWith(error: unknown): void {
    this.failure ??= { error };
    this.wake();
  }

  /** Read the index pages, one after the other; chunks are planned as their pages come. */
  private async readPages(): Promise<void> {
    try {
      for (let count = this.index.pagesRead + 1; count <= this.index.pages.length; count++) {
        await this.source.readPages(count);
        this.plan();
      }
      this.pagesDone = true;
      this.wake();
    } catch (error) {
      this.stopWith(error);
    }
  }

  /** Put the segments of chunks that are newly known among those that are wanted. */
  private plan(): void {
    const { priority } = this.options;
    const chunks = Array.from({ length: this.index.chunkCount - this.plannedChunks }, (_, i) => this.plannedChunks + i);
    this.plannedChunks = this.index.chunkCount;
    const drawn = chunks.filter((chunk) => this.isWanted(chunk));
    const ordered = priority === undefined ? drawn : this.byPriority(drawn, priority);
    const taken = ordered.filter((chunk) => {
      const splats = this.index.chunks.splats[chunk]!;
      this.budget -= splats * this.rowBytes;
      this.splatBudget -= splats;
      return this.budget >= 0 && this.splatBudget >= 0;
    });
    this.queue.keepAtMost(Math.min(MOST_KEPT_BYTES, Math.max(this.budget, 0)));
    for (const chunk of taken) this.queue.expect(chunk);
    const layers = this.options.compensate ? this.index.compensation : [];
    const segments = [...layers, ...this.queue.allMissing()].filter((segment) => !this.asked.has(segment));
    const unique = [...new Set(segments)];
    // Without priorities segments are wanted in the order of the file, which shows most for its bytes.
    if (priority === undefined) unique.sort((a, b) => a - b);
    for (const segment of unique) this.asked.add(segment);
    const { beginning } = this.source;
    const isHere = (segment: number): boolean => this.endOf(segment) <= beginning.here.length;
    const held = new Set(unique.filter((segment) => beginning.holds(this.endOf(segment))));
    this.wanted.push(...unique.filter((segment) => !held.has(segment)));
    const here = [...held].filter(isHere);
    const coming = [...held].filter((segment) => !isHere(segment)).sort((a, b) => a - b);
    void this.acceptBeginning([...here, ...coming]);
    this.ask();
  }

  /** Whether a chunk is drawn at the level that is wanted; notes those that are not. */
  private isWanted(chunk: number): boolean {
    const { level, ending } = this.options;
    const end = this.index.scene.levels[level ?? -1]?.chunks ?? this.index.totalChunkCount;
    const isWanted = chunk < end && (ending || this.index.isDrawn(chunk, end));
    if (!isWanted) this.leftOut.add(chunk);
    return isWanted;
  }

  private byPriority(chunks: number[], priority: (chunk: ChunkInfo) => number): number[] {
    const { splats, box, contribution, layer, cell, object, until } = this.index.chunks;
    return chunks
      .map((chunk) => ({
        chunk,
        value: priority({
          chunk,
          splats: splats[chunk]!,
          box: box.slice(6 * chunk, 6 * chunk + 6),
          contribution: contribution[chunk]!,
          layer: layer[chunk]!,
          cell: cell[chunk]!,
          object: object[chunk]!,
          until: until[chunk]!,
        }),
      }))
      .filter(({ value }) => value >= 0)
      .sort((a, b) => b.value - a.value)
      .map(({ chunk }) => chunk);
  }

  private endOf(segment: number): number {
    const { offset, length } = this.rangeOf(segment);
    return offset + length;
  }

  /** Accept segments that the first request has brought or brings, one after the other, and let the page do other things between them. */
  private async acceptBeginning(segments: readonly number[]): Promise<void> {
    const { beginning } = this.source;
    this.waits += segments.length;
    let slice = performance.now();
    for (const segment of segments) {
      const end = this.endOf(segment);
      try {
        if (beginning.here.length < end) {
          await beginning.upTo(end, this.abort.signal);
          slice = performance.now();
        } else if (performance.now() - slice > SLICE_MILLISECONDS) {
          await new Promise((resolve) => setTimeout(resolve, 0));
          this.abort.signal.throwIfAborted();
          slice = performance.now();
        }
        if (beginning.here.length < end) throw new SourceError(`the file ends before byte ${end}`, undefined, true);
        this.accept(segment, beginning.here.slice(this.rangeOf(segment).offset, end));
      } catch (error) {
        this.lose(error, [segment]);
      } finally {
        this.waits--;
        this.wake();
      }
    }
  }

  /** Make requests while there is something to ask for and the caller keeps up. */
  private ask(): void {
    const isSequential = !this.source.answersRanges;
    const most = isSequential ? 1 : MAX_REQUESTS;
    while (this.requests < most && this.waiting.length < MAX_WAITING && this.failure === undefined) {
      const request = isSequential ? this.wholeRest() : nextRequest(this.wanted, this.rangeOf, this.requestBytes);
      if (request === undefined) return;
      this.requestBytes *= 2;
      this.requests++;
      void this.run(request);
    }
  }

  /** One request for all that is wanted, in file order, from a source that does not answer ranges. */
  private wholeRest(): RangeRequest | undefined {
    if (!this.pagesDone || this.wanted.length === 0) return undefined;
    const segments = this.wanted.splice(0).sort((a, b) => a - b);
    const { offset } = this.rangeOf(segments[0]!);
    const last = this.rangeOf(segments.at(-1)!);
    return { offset, length: last.offset + last.length - offset, segments };
  }

  private readonly rangeOf = (segment: number): ByteRange => this.source.places.range(segment);

  private async run(request: RangeRequest): Promise<void> {
    const assembler = new RangeAssembler(request, this.rangeOf);
    const received = new Set<number>();
    try {
      await this.source.reader.parts(request, this.abort.signal, (part) => {
        for (const { segment, payload } of assembler.add(part)) {
          received.add(segment);
          this.accept(segment, payload);
        }
      });
    } catch (error) {
      this.lose(
        error,
        request.segments.filter((segment) => !received.has(segment)),
      );
    } finally {
      this.requests--;
      this.wake();
    }
  }

  /** Go on without segments that did not come, or end where no others would come either. */
  private lose(error: unknown, segments: readonly number[]): void {
    // An object of a folder that is not as it should be spoils no other.
    const isOfObject =
      error instanceof CogsplatError && (error.code === "segment-missing" || error.code === "segment-object");
    const isPartial = isOfObject || (error instanceof SourceError && error.retryable);
    if (this.abort.signal.aborted || !isPartial) this.stopWith(error);
    else for (const segment of segments) this.damage(error, this.queue.lose(segment));
  }

  /** Check a segment's CRC and hand it on; what is damaged is asked for once more, around caches. */
  private accept(segment: number, payload: Uint8Array): void {
    try {
      this.index.checkCrc(segment, payload);
    } catch (error) {
      if (!(error instanceof CogsplatError)) throw error;
      this.requests++;
      void this.fetchAgain(segment);
      return;
    }
    this.take(segment, payload);
  }

  private take(segment: number, payload: Uint8Array): void {
    const { kind, owner } = this.index.segments;
    if (kind[segment] === SegmentKind.compensation) this.source.compensation.add(owner[segment]!, payload);
    else this.queue.add(segment, payload);
  }

  private async fetchAgain(segment: number): Promise<void> {
    try {
      const payload = await this.source.reader.all(this.rangeOf(segment), this.abort.signal, true);
      this.index.checkCrc(segment, payload);
      this.take(segment, payload);
    } catch (error) {
      if (error instanceof CogsplatError || error instanceof SourceError) this.damage(error, this.queue.lose(segment));
      else this.stopWith(error);
    } finally {
      this.requests--;
      this.wake();
    }
  }

  /** Report what cannot be had; without a listener the stream ends with the error. */
  private damage(error: unknown, chunks: readonly number[]): void {
    const { onDamage } = this.options;
    const isTold = error instanceof CogsplatError || error instanceof SourceError;
    if (onDamage === undefined || !isTold) this.stopWith(error);
    else if (chunks.length === 0) onDamage(error, undefined);
    else for (const chunk of chunks) onDamage(error, chunk);
    this.wake();
  }
}
