import { parentsOf } from "../container/chunk_sets.js";
import type { SceneIndex } from "../container/scene_index.js";
import { SegmentKind } from "../container/tables.js";
import { readViewTable, type ViewTable } from "../container/view_table.js";
import { CogsplatError, SourceError } from "../errors.js";
import { DEFAULT_RANGES } from "../scene/packed_splats.js";
import { along, byBoxes, byViewTable, type PoseRatios } from "../schedule/chunk_ratios.js";
import type { Pose } from "../schedule/poses.js";
import { Scheduler } from "../schedule/scheduler.js";
import type { ChunkService } from "../workers/decode_task.js";
import { ChunkQueue } from "./chunk_queue.js";
import { PoseHistory } from "./pose_history.js";
import { type SegmentUnit, segmentUnits, unitsByChunk } from "./segment_units.js";
import { bytesPerSplat, type ChunkUpdate, type StreamOptions } from "./stream_options.js";
import type { StreamedScene } from "./streamed_scene.js";
import { UnitRequests } from "./unit_requests.js";

export { along, byBoxes, bySgss, byViewTable, countedSplats, type PoseRatios } from "../schedule/chunk_ratios.js";
export { type Pose, path, predicted, type WeightedPose } from "../schedule/poses.js";
export { type Decision, type Holdings, Scheduler, type Unit } from "../schedule/scheduler.js";

/** Time between two looks at where a visitor is, at least, seconds (docs/streaming.md, 11). */
const LOOK_SECONDS = 0.1;
/** Changes that may wait for the caller before no more is fetched. */
const MAX_WAITING = 64;
/** Most bytes of decoded heads that wait for their tails. */
const MOST_KEPT_BYTES = 32 * 2 ** 20;

/** How a scene is visited; what `splatBudget` or `memoryBudget` have no room for is fetched when it is looked at, in the place of other things. */
export interface VisitOptions
  extends Pick<
    StreamOptions,
    "signal" | "degree" | "format" | "ranges" | "memoryBudget" | "splatBudget" | "compensate" | "onDamage"
  > {
  /** Told when all that the pose is worth is there, and when something is missing again. */
  readonly onSettled?: (isSettled: boolean) => void;
}

/** A chunk that has come, for the first time or with more, behind its parent (SPEC 5.4); or one that was thrown away. */
export type VisitChange =
  | ({ readonly kind: "rows" } & Omit<ChunkUpdate, "prefix">)
  | { readonly kind: "gone"; readonly chunk: number };

/**
 * A visitor in a scene: what the pose and the next second of its path show is fetched first, and in a scene that is larger
 * than its budget the rest makes room for it (docs/streaming.md).
 */
export class Visit {
  private readonly index: SceneIndex;
  private readonly requests: UnitRequests;
  private readonly queue: ChunkQueue;
  private readonly poses = new PoseHistory();
  private readonly degree: number;
  private budget: number;
  private units: SegmentUnit[] = [];
  private unitsOf: readonly (readonly number[])[] = [];
  private scheduler: Scheduler | undefined;
  private parents: Int32Array = new Int32Array();
  private readonly there = new Set<number>();
  /** Units that come otherwise than by a request that can be stopped: from the first bytes, or once more around caches. */
  private readonly aside = new Set<number>();
  /** Chunks of which rows were given, and rows that wait for those of their parent. */
  private readonly given = new Set<number>();
  private readonly early = new Map<number, Omit<ChunkUpdate, "prefix">>();
  /** Chunks that cannot be had; nothing waits for them. */
  private readonly lost = new Set<number>();
  private readonly waiting: VisitChange[] = [];
  private table: ViewTable | undefined;
  private rule: PoseRatios | undefined;
  private ratios: Float64Array | undefined;
  private ratiosAt = -Infinity;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private isTurning = false;
  private settled = false;
  private isOver = false;
  private failure: { readonly error: unknown } | undefined;
  private wake: () => void = () => undefined;

  /**
   * Begin to visit a scene.
   *
   * @throws SourceError where the server gives the whole file whatever it is asked for.
   *
   * @example
   * ```ts
   * const visit = await Visit.begin(scene, { format: "packed", splatBudget: 2_000_000 });
   * visit.look(camera.pose); // again whenever it moves
   * for await (const change of visit.changes()) {
   *   if (change.kind === "rows") draw(change);
   *   else remove(change.chunk);
   * }
   * ```
   */
  static async begin(scene: StreamedScene, options: VisitOptions = {}): Promise<Visit> {
    if (!scene.answersRanges)
      throw new SourceError(
        "a server without ranges, expected one that answers them: nothing can be chosen",
        undefined,
        false,
      );
    scene.checkSize(options);
    return new Visit(scene, await scene.makeService(), options);
  }

  private constructor(
    private readonly source: StreamedScene,
    private readonly service: ChunkService,
    private readonly options: VisitOptions,
  ) {
    const { index } = source;
    const { format = "splats", ranges, memoryBudget = Infinity, splatBudget = Infinity } = options;
    this.index = index;
    this.degree = Math.min(options.degree ?? index.scene.shDegree, index.scene.shDegree);
    this.budget = Math.min(splatBudget, Math.floor(memoryBudget / bytesPerSplat(format, this.degree)));
    this.queue = new ChunkQueue(
      index,
      service,
      { degree: this.degree, format, ranges: { ...DEFAULT_RANGES, ...ranges }, refine: true },
      (update) => this.give(update),
      (error, chunk) => {
        this.forgo(chunk);
        this.damage(error, [chunk]);
      },
    );
    this.queue.keepAtMost(MOST_KEPT_BYTES);
    this.requests = new UnitRequests(source.reader, (unit) => source.places.range(this.units[unit]!.segment), {
      came: (unit, payload) => this.came(unit, payload),
      failed: (error, units) => this.lose(error, units),
      ended: () => this.turnSoon(),
    });
  }

  /** Look from somewhere: what is fetched follows, and where the path goes on to. */
  look(pose: Pose): void {
    this.poses.add(pose, performance.now() / 1000);
    this.turnSoon();
  }

  /** How much more than usual the pose of now shows of each chunk (docs/streaming.md, 4 and 5); undefined before the first look. */
  shown(): Float64Array | undefined {
    const { latest } = this.poses;
    return latest && (this.rule ?? this.makeRule())(latest);
  }

  /** Hold at most so many splats from now on. */
  limit(splats: number): void {
    this.budget = splats;
    this.turnSoon();
  }

  /**
   * What comes and goes; it ends when all of the scene is there, else with the signal or when it is left.
   */
  async *changes(): AsyncGenerator<VisitChange, void, undefined> {
    const { signal } = this.options;
    const onAbort = (): void => this.wake();
    signal?.addEventListener("abort", onAbort);
    void this.readPages();
    this.enterUnits();
    try {
      for (;;) {
        signal?.throwIfAborted();
        const change = this.waiting.shift();
        if (change !== undefined) {
          yield change;
          if (this.waiting.length === MAX_WAITING - 1) this.turnSoon();
          continue;
        }
        if (this.failure !== undefined) throw this.failure.error;
        if (this.isWhole) return;
        await new Promise<void>((resolve) => (this.wake = resolve));
      }
    } finally {
      this.isOver = true;
      clearTimeout(this.timer);
      signal?.removeEventListener("abort", onAbort);
      this.requests.close();
      this.service.close();
    }
  }

  private get isWhole(): boolean {
    return this.index.complete && this.there.size === this.units.length && this.queue.idle && this.aside.size === 0;
  }

  /** Read the index pages, one after the other; their segments can be chosen as they come. */
  private async readPages(): Promise<void> {
    try {
      for (let count = this.index.pagesRead + 1; count <= this.index.pages.length; count++) {
        await this.source.readPages(count);
        this.enterUnits();
      }
    } catch (error) {
      this.fail(error);
    }
  }

  private enterUnits(): void {
    this.units = segmentUnits(this.index, this.degree, this.options.compensate ?? false);
    this.unitsOf = unitsByChunk(this.units, this.index.chunkCount);
    this.parents = parentsOf(this.index.chunks.cell);
    this.scheduler = new Scheduler(this.units, this.index.chunks.splats);
    this.rule = undefined;
    this.turnSoon();
  }

  private fail(error: unknown): void {
    this.failure ??= { error };
    this.wake();
  }

  /** Decide when what happens now has happened. */
  private turnSoon(): void {
    if (this.isTurning) return;
    this.isTurning = true;
    queueMicrotask(() => {
      this.isTurning = false;
      if (!this.isOver && this.failure === undefined) this.turn();
    });
  }

  private turn(): void {
    if (this.scheduler === undefined) return;
    const ratios = this.currentRatios();
    let decision = this.scheduler.decide(ratios, this.holdings());
    // What was stopped together with something else is chosen anew.
    for (let isSure = false; !isSure; ) {
      isSure = this.requests.stop(decision.stop) <= decision.stop.length;
      for (const chunk of decision.evict) this.evict(chunk);
      if (!isSure) decision = this.scheduler.decide(ratios, this.holdings());
    }
    const isBusy = this.waiting.length >= MAX_WAITING;
    if (!isBusy) this.fetch(decision.fetch, ratios);
    this.settle(!isBusy && decision.fetch.length === 0 && this.requests.underWay.length === 0);
  }

  private settle(isIdle: boolean): void {
    const isSettled =
      isIdle && this.aside.size === 0 && this.queue.idle && this.index.complete && this.timer === undefined;
    if (isSettled !== this.settled) this.options.onSettled?.(isSettled);
    this.settled = isSettled;
    if (this.isWhole) this.wake();
  }

  private holdings(): Parameters<Scheduler["decide"]>[1] {
    const { link, received, underWay } = this.requests;
    const { bytesPerSecond, latency } = link;
    const budgetSplats = this.budget === Infinity ? 0 : this.budget;
    return {
      there: this.there,
      underWay: new Set([...underWay, ...this.aside]),
      received,
      budgetSplats,
      bytesPerSecond,
      latency,
    };
  }

  /** Ratios of the poses to come, made anew when these have changed, and some time has passed. */
  private currentRatios(): Float64Array {
    const now = performance.now() / 1000;
    const path = this.poses.path(now);
    const isDue = now - this.ratiosAt >= LOOK_SECONDS;
    if (this.ratios === undefined || this.rule === undefined || (isDue && this.poses.hasChanged)) {
      this.rule ??= this.makeRule();
      this.ratios = path === undefined ? new Float64Array(this.index.chunkCount).fill(1) : along(this.rule, path);
      this.ratiosAt = now;
      this.poses.hasChanged = false;
    }
    // A visitor who stops is noticed by looking again.
    if ((this.poses.hasChanged || this.poses.isMoving) && this.timer === undefined) {
      this.timer = setTimeout(() => {
        this.timer = undefined;
        this.poses.hasChanged = true;
        this.turnSoon();
      }, 1000 * LOOK_SECONDS);
    }
    return this.ratios;
  }

  private makeRule(): PoseRatios {
    const { box, contribution } = this.index.chunks;
    // The table is about all chunks of the file: while boxes are missing it cannot be used.
    return this.table !== undefined && this.index.complete
      ? byViewTable(this.table, box, contribution)
      : byBoxes(box, contribution);
  }

  private fetch(units: readonly number[], ratios: Float64Array): void {
    for (const unit of units) if (this.units[unit]!.chunk >= 0) this.queue.expect(this.units[unit]!.chunk);
    const { beginning, places } = this.source;
    const endOf = (unit: number): number => {
      const { offset, length } = places.range(this.units[unit]!.segment);
      return offset + length;
    };
    const asked = units.filter((unit) => !beginning.holds(endOf(unit)));
    for (const unit of units) if (beginning.holds(endOf(unit))) void this.fromBeginning(unit, endOf(unit));
    this.requests.start(asked, (unit) => {
      const { chunk } = this.units[unit]!;
      return chunk < 0 || ratios[chunk]! >= 1 ? "high" : "low";
    });
  }

  /** Take a unit that the first request has brought or brings. */
  private async fromBeginning(unit: number, end: number): Promise<void> {
    const { beginning } = this.source;
    this.aside.add(unit);
    try {
      await beginning.upTo(end, this.options.signal);
      if (beginning.here.length < end) throw new SourceError(`the file ends before byte ${end}`, undefined, true);
      if (this.aside.delete(unit)) this.came(unit, beginning.here.slice(end - this.units[unit]!.size, end));
    } catch (error) {
      if (this.aside.delete(unit)) this.lose(error, [unit]);
    }
    this.turnSoon();
  }

  /** Take a unit; what is damaged is asked for once more, around caches. */
  private came(unit: number, payload: Uint8Array): void {
    const { segment } = this.units[unit]!;
    try {
      this.index.checkCrc(segment, payload);
    } catch (error) {
      if (!(error instanceof CogsplatError)) throw error;
      void this.fetchAgain(unit);
      return;
    }
    this.take(unit, payload);
  }

  private async fetchAgain(unit: number): Promise<void> {
    const { segment } = this.units[unit]!;
    this.aside.add(unit);
    try {
      const payload = await this.source.reader.all(this.source.places.range(segment), this.options.signal, true);
      this.index.checkCrc(segment, payload);
      if (this.aside.delete(unit)) this.take(unit, payload);
    } catch (error) {
      if (this.aside.delete(unit)) this.lose(error, [unit]);
    }
    this.turnSoon();
  }

  private take(unit: number, payload: Uint8Array): void {
    const { segment } = this.units[unit]!;
    const { kind, owner } = this.index.segments;
    this.there.add(unit);
    if (kind[segment] === SegmentKind.compensation) this.source.compensation.add(owner[segment]!, payload);
    else if (kind[segment] === SegmentKind.viewTable) void this.useTable(payload, unit);
    else this.queue.add(segment, payload);
    this.turnSoon();
  }

  private async useTable(payload: Uint8Array, unit: number): Promise<void> {
    try {
      const kernels = (await this.source.loadKernels())();
      this.table = readViewTable(kernels, payload, this.index.totalChunkCount);
      this.rule = undefined;
      this.turnSoon();
    } catch (error) {
      this.lose(error, [unit]);
    }
  }

  /** Go on without units that cannot be had, or end where no others would come either. */
  private lose(error: unknown, units: readonly number[]): void {
    // An object of a folder that is not as it should be spoils no other.
    const isOfOne = error instanceof CogsplatError && error.code !== "source-changed";
    if (!isOfOne && !(error instanceof SourceError && error.retryable)) this.fail(error);
    else {
      for (const unit of units) {
        this.there.add(unit);
        const chunks = this.queue.lose(this.units[unit]!.segment);
        const { chunk, isHead } = this.units[unit]!;
        if (isHead) this.forgo(chunk);
        this.damage(error, chunks);
      }
    }
  }

  /** Wait for a chunk no more. */
  private forgo(chunk: number): void {
    this.lost.add(chunk);
    for (const update of [...this.early.values()]) if (this.parents[update.chunk] === chunk) this.give(update);
  }

  /** Report what cannot be had; without a listener the visit ends with the error. */
  private damage(error: unknown, chunks: readonly number[]): void {
    const { onDamage } = this.options;
    if (onDamage === undefined || !(error instanceof CogsplatError || error instanceof SourceError)) this.fail(error);
    else for (const chunk of chunks.length === 0 ? [undefined] : chunks) onDamage(error, chunk);
    this.turnSoon();
  }

  /** Give rows to the caller, behind those of the chunk's parent; those of a chunk that was thrown away are left. */
  private give(update: Omit<ChunkUpdate, "prefix">): void {
    const { chunk } = update;
    this.turnSoon();
    if (!this.isHeld(chunk)) return;
    const parent = this.parents[chunk]!;
    if (parent >= 0 && !this.given.has(parent) && !this.lost.has(parent)) {
      this.early.set(chunk, update);
      return;
    }
    this.early.delete(chunk);
    this.waiting.push({ kind: "rows", ...update });
    this.wake();
    if (this.given.has(chunk)) return;
    this.given.add(chunk);
    for (const child of [...this.early.values()]) if (this.parents[child.chunk] === chunk) this.give(child);
  }

  private isHeld(chunk: number): boolean {
    return this.unitsOf[chunk]!.some((unit) => this.units[unit]!.isHead && this.there.has(unit));
  }

  /** Throw a chunk away. */
  private evict(chunk: number): void {
    for (const unit of this.unitsOf[chunk]!) {
      this.there.delete(unit);
      this.aside.delete(unit);
      this.requests.forget(unit);
    }
    this.queue.close(chunk);
    this.early.delete(chunk);
    if (!this.given.delete(chunk)) return;
    this.waiting.push({ kind: "gone", chunk });
    this.wake();
  }
}
