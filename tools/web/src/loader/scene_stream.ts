import type { ChunkService } from "../workers/decode_task.js";
import { MAX_REQUESTS } from "./byte_source.js";
import { nextRequest, type RangeRequest } from "./range_plan.js";
import { type ChunkRows, type FetchSource, MOST_KEPT_BYTES, SceneFetch } from "./scene_fetch.js";
import { bytesPerSplat, type ChunkInfo, type ChunkUpdate, type StreamOptions } from "./stream_options.js";

/** Bytes of the first request after the beginning; each next one is twice as long, so that first chunks arrive soon. */
const FIRST_REQUEST = 262_144;

/** A fetch in the order of the file or of a priority, within budgets of bytes and splats. */
export class SceneStream extends SceneFetch<ChunkUpdate> {
  /** Segments to request, in the order of their urgency. */
  private wanted: number[] = [];
  private readonly planned = new Set<number>();
  private readonly yielded = new Set<number>();
  /** Chunks excluded from the fetch: chunks that end, or that the level does not draw. */
  private readonly excluded = new Set<number>();
  private prefix = 0;
  private requestBytes = FIRST_REQUEST;
  private byteBudget: number;
  private splatBudget: number;
  private plannedChunks = 0;
  private readonly rowBytes: number;

  constructor(source: FetchSource, service: ChunkService, options: StreamOptions) {
    super(source, service, options);
    const { level, format = "splats", memoryBudget = Infinity, splatBudget = Infinity } = options;
    if (level !== undefined && !this.index.scene.levels[level]) throw new RangeError(`level ${level}`);
    this.rowBytes = bytesPerSplat(format, this.degree);
    this.byteBudget = memoryBudget;
    this.splatBudget = splatBudget;
  }

  protected override get hasMore(): boolean {
    return !this.index.complete || this.wanted.length > 0 || this.plannedChunks < this.index.chunkCount;
  }

  protected override onDecoded(rows: ChunkRows): void {
    this.yielded.add(rows.chunk);
    while (this.yielded.has(this.prefix) || this.excluded.has(this.prefix)) this.prefix++;
    this.push({ ...rows, prefix: this.prefix });
    this.chooseSoon();
  }

  /** Append the segments of chunks that have become known. */
  protected override onPage(): void {
    const { priority } = this.options;
    const count = this.index.chunkCount - this.plannedChunks;
    const chunks = Array.from({ length: count }, (_, i) => this.plannedChunks + i);
    this.plannedChunks = this.index.chunkCount;
    const drawn = chunks.filter((chunk) => this.isDrawn(chunk));
    const ordered = priority === undefined ? drawn : this.byPriority(drawn, priority);
    const fitting = ordered.filter((chunk) => {
      const splats = this.index.chunks.splats[chunk]!;
      this.byteBudget -= splats * this.rowBytes;
      this.splatBudget -= splats;
      return this.byteBudget >= 0 && this.splatBudget >= 0;
    });
    this.queue.keepAtMost(Math.min(MOST_KEPT_BYTES, Math.max(this.byteBudget, 0)));
    for (const chunk of fitting) this.queue.expect(chunk);
    const layers = this.options.compensate ? this.index.compensation : [];
    const segments = [...new Set([...layers, ...this.queue.allMissing()])].filter((s) => !this.planned.has(s));
    // Without priorities the order is that of the file, which shows most for its bytes.
    if (priority === undefined) segments.sort((a, b) => a - b);
    for (const segment of segments) this.planned.add(segment);
    this.wanted.push(...this.acceptFromBeginning(segments));
  }

  /** Return whether the level draws a chunk; exclude it otherwise. */
  private isDrawn(chunk: number): boolean {
    const { level, ending } = this.options;
    const end = this.index.scene.levels[level ?? -1]?.chunks ?? this.index.totalChunkCount;
    const isDrawn = chunk < end && (ending || this.index.isDrawn(chunk, end));
    if (!isDrawn) this.excluded.add(chunk);
    return isDrawn;
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

  protected override choose(hasRoom: boolean): void {
    // Another fetch of the scene may have read a page.
    if (this.plannedChunks < this.index.chunkCount) this.onPage();
    const isSequential = !this.source.answersRanges;
    const most = isSequential ? 1 : MAX_REQUESTS;
    while (hasRoom && this.requests.count < most) {
      const request = isSequential ? this.wholeRest() : nextRequest(this.wanted, this.rangeOf, this.requestBytes);
      if (request === undefined) return;
      this.requestBytes *= 2;
      this.requests.start(request);
    }
  }

  /** Return one request of all segments left, in file order, for a server that ignores ranges. */
  private wholeRest(): RangeRequest | undefined {
    if (!this.index.complete || this.wanted.length === 0) return undefined;
    const segments = this.wanted.splice(0).sort((a, b) => a - b);
    const { offset } = this.rangeOf(segments[0]!);
    const last = this.rangeOf(segments.at(-1)!);
    return { offset, length: last.offset + last.length - offset, segments };
  }
}
