import { SegmentKind } from "../container/tables.js";
import { readViewTable } from "../container/view_table.js";
import { SourceError } from "../errors.js";
import { sumAlongPath } from "../schedule/chunk_ratios.js";
import { IndexRatios } from "../schedule/index_ratios.js";
import type { Pose } from "../schedule/poses.js";
import { EVICTED_SECONDS, type Holdings, Scheduler } from "../schedule/scheduler.js";
import type { ChunkService } from "../workers/decode_task.js";
import { PoseHistory } from "./pose_history.js";
import { type ChunkRows, MOST_KEPT_BYTES, SceneFetch } from "./scene_fetch.js";
import { SegmentUnits } from "./segment_units.js";
import { bytesPerSplat, type StreamOptions } from "./stream_options.js";
import type { StreamedScene } from "./streamed_scene.js";

export {
  byBoxes,
  bySgss,
  byViewTable,
  effectiveSplats,
  type PoseRatios,
  sumAlongPath,
} from "../schedule/chunk_ratios.js";
export { type Pose, predictPath, predictPose, type WeightedPose } from "../schedule/poses.js";
export { type Decision, type Holdings, Scheduler } from "../schedule/scheduler.js";
export type { Unit } from "../schedule/unit_links.js";

/** Shortest time between two evaluations of the pose, seconds (docs/streaming.md, 11). */
const EVALUATION_SECONDS = 0.1;

/** Options of a visit; in a scene larger than `splatBudget` or `memoryBudget` chunks are evicted to make room. */
export interface VisitOptions
  extends Pick<
    StreamOptions,
    "signal" | "degree" | "format" | "ranges" | "memoryBudget" | "splatBudget" | "compensate" | "onDamage"
  > {
  /** Called when all chunks that the pose is worth have arrived, and when some are missing again. */
  readonly onSettled?: (isSettled: boolean) => void;
}

/** New or more detailed rows of a chunk, always after its parent's (SPEC 5.4); or an evicted chunk. */
export type VisitChange =
  | ({ readonly kind: "rows" } & ChunkRows)
  | { readonly kind: "evicted"; readonly chunk: number };

/**
 * A fetch in the order of the view: the chunks visible from the pose and its next second come first, and in a scene
 * larger than the budget the others are evicted (docs/streaming.md).
 */
export class Visit extends SceneFetch<VisitChange> {
  private readonly poses = new PoseHistory();
  private budget: number;
  private readonly units: SegmentUnits;
  private scheduler: Scheduler | undefined;
  /** Units that have arrived or cannot be fetched. */
  private readonly arrived = new Set<number>();
  /** Chunks whose rows were yielded and not evicted since. */
  private readonly yielded = new Set<number>();
  /** Decoded rows of chunks whose parent is not yielded yet. */
  private readonly early = new Map<number, ChunkRows>();
  /** Chunks that cannot be fetched or decoded; their children are yielded without a parent. */
  private readonly lost = new Set<number>();
  /** Rows evicted lately: their worth then, and the end of the time for which it counts, seconds. */
  private readonly evicted = new Map<number, { readonly worth: number; readonly until: number }>();
  private readonly poseRatios: IndexRatios;
  /** Ratios along the path; undefined where an index or a view table has become known since. */
  private pathRatios: Float64Array | undefined;
  private evaluatedAt = -Infinity;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private isSettled = false;

  /**
   * Begin to visit a scene.
   *
   * @throws SourceError where the server does not answer range requests.
   *
   * @example
   * ```ts
   * const visit = await Visit.begin(scene, { format: "packed", splatBudget: 2_000_000 });
   * visit.setPose(camera.pose); // again whenever it moves
   * for await (const change of visit.changes()) {
   *   if (change.kind === "rows") draw(change);
   *   else remove(change.chunk);
   * }
   * ```
   */
  static async begin(scene: StreamedScene, options: VisitOptions = {}): Promise<Visit> {
    if (!scene.answersRanges) {
      throw new SourceError("a visit needs a server that answers range requests", undefined, false);
    }
    scene.checkSize(options);
    return new Visit(scene, await scene.makeService(), options);
  }

  private constructor(
    private readonly scene: StreamedScene,
    service: ChunkService,
    private readonly visitOptions: VisitOptions,
  ) {
    super(scene, service, visitOptions);
    const { format = "splats", memoryBudget = Infinity, splatBudget = Infinity } = visitOptions;
    this.budget = Math.min(splatBudget, Math.floor(memoryBudget / bytesPerSplat(format, this.degree)));
    this.queue.keepAtMost(MOST_KEPT_BYTES);
    this.units = new SegmentUnits(this.index, this.degree, visitOptions.compensate ?? false);
    this.poseRatios = new IndexRatios(this.index.indexes);
  }

  /** Set the pose of the camera; requests follow it and the path that its poses predict. */
  setPose(pose: Pose): void {
    this.poses.add(pose, performance.now() / 1000);
    this.chooseSoon();
  }

  /** Set the maximum number of splats in memory. */
  setSplatBudget(splats: number): void {
    this.budget = splats;
    this.chooseSoon();
  }

  /**
   * Return the ratio of the share in the picture of the latest pose to the share of contribution (docs/streaming.md, 4 and
   * 5).
   *
   * @returns Ratio of each row of `SceneIndex.rows`; undefined before the first pose.
   */
  ratios(): Float64Array | undefined {
    const { latest } = this.poses;
    return latest && this.poseRatios.of(latest);
  }

  /** Pages are requested as units. */
  protected override async readPages(): Promise<void> {}

  protected override onPage(): void {
    for (const unit of this.units.enter()) this.arrived.add(unit);
    this.scheduler = new Scheduler(this.units.units, this.units.splats, this.units.contribution);
    this.pathRatios = undefined;
  }

  protected override get hasMore(): boolean {
    return this.units.isBehind || this.arrived.size < this.units.units.length;
  }

  protected override onEnd(): void {
    clearTimeout(this.timer);
  }

  protected override choose(hasRoom: boolean): void {
    const isFirst = this.scheduler === undefined;
    if (this.units.isBehind) this.onPage();
    const scheduler = this.scheduler!;
    const ratios = this.currentRatios();
    if (isFirst) this.request(this.unitsInBeginning(), ratios);
    let decision = scheduler.decide(ratios, this.holdings());
    // A stopped request may contain units that the decision keeps. They are now missing: decide again.
    for (let isFinal = false; !isFinal; ) {
      isFinal = this.requests.stop(this.segmentsOf(decision.stop)) <= decision.stop.length;
      for (const [row, worth] of decision.evict) this.evict(row, worth);
      if (!isFinal) decision = scheduler.decide(ratios, this.holdings());
    }
    if (hasRoom) this.request(decision.fetch, ratios);
    const isDone = hasRoom && decision.fetch.length === 0 && this.requests.inFlight.length === 0;
    this.reportSettled(isDone && this.isIdle && this.timer === undefined);
  }

  /** Return the units that come with the first request, as far as the budget has room (docs/streaming.md, 11). */
  private unitsInBeginning(): number[] {
    const { units, splats } = this.units;
    const taken = new Set<number>();
    let room = this.budget;
    for (const [unit, { segment, row, isHead, dependencies }] of units.entries()) {
      const needed = isHead ? splats[row]! : 0;
      if (!this.isInBeginning(segment) || needed > room || !dependencies.every((before) => taken.has(before))) continue;
      taken.add(unit);
      room -= needed;
    }
    return [...taken];
  }

  private reportSettled(isSettled: boolean): void {
    if (isSettled !== this.isSettled) this.visitOptions.onSettled?.(isSettled);
    this.isSettled = isSettled;
  }

  private segmentsOf(units: readonly number[]): number[] {
    return units.map((unit) => this.units.units[unit]!.segment);
  }

  private holdings(): Holdings {
    const { link, partial, inFlight } = this.requests;
    const unit = (segment: number): number => this.units.of(segment);
    const now = performance.now() / 1000;
    for (const [chunk, { until }] of this.evicted) if (until <= now) this.evicted.delete(chunk);
    return {
      arrived: this.arrived,
      inFlight: new Set([...inFlight, ...this.uncancellable].map(unit)),
      received: new Map([...partial].map(([segment, bytes]) => [unit(segment), bytes])),
      budgetSplats: this.budget === Infinity ? 0 : this.budget,
      evictedWorths: new Map([...this.evicted].map(([chunk, { worth }]) => [chunk, worth])),
      bytesPerSecond: link.bytesPerSecond,
      latency: link.latency,
    };
  }

  /** Return the ratios along the predicted path; new poses are evaluated at intervals of `EVALUATION_SECONDS`. */
  private currentRatios(): Float64Array {
    const now = performance.now() / 1000;
    const path = this.poses.path(now);
    const isDue = now - this.evaluatedAt >= EVALUATION_SECONDS;
    if (this.pathRatios === undefined || (isDue && this.poses.hasChanged)) {
      this.pathRatios =
        path === undefined ? new Float64Array(this.index.rows.count).fill(1) : sumAlongPath(this.poseRatios.of, path);
      this.evaluatedAt = now;
      this.poses.hasChanged = false;
    }
    // No pose is set when the camera stops: the timer evaluates its last pose again, until no eviction counts any more.
    const changes = this.poses.hasChanged || this.poses.isMoving || this.evicted.size > 0;
    if (changes && this.timer === undefined) {
      this.timer = setTimeout(() => {
        this.timer = undefined;
        this.poses.hasChanged = true;
        this.chooseSoon();
      }, 1000 * EVALUATION_SECONDS);
    }
    return this.pathRatios;
  }

  private request(units: readonly number[], ratios: Float64Array): void {
    const { chunks, pages } = this.index.rows;
    for (const unit of units) {
      const { row } = this.units.units[unit]!;
      if (row >= 0 && pages[row] === undefined) this.queue.expect(chunks[row]!);
    }
    const segments = this.acceptFromBeginning(this.segmentsOf(units));
    this.requests.fillConnection(segments, (segment) => {
      const { row } = this.units.units[this.units.of(segment)]!;
      return row < 0 || ratios[row]! >= 1 ? "high" : "low";
    });
  }

  /** Check a segment; check and enter a page. */
  protected override check(segment: number, payload: Uint8Array): void {
    const page = this.index.pages[-1 - segment];
    if (page === undefined) super.check(segment, payload);
    else this.source.places.addPage(page, payload);
  }

  protected override use(segment: number, payload: Uint8Array): void {
    this.arrived.add(this.units.of(segment));
    if (segment < 0) this.onPage();
    else if (this.index.segments.kind[segment] === SegmentKind.viewTable) void this.useTable(payload, segment);
    else super.use(segment, payload);
  }

  private async useTable(payload: Uint8Array, segment: number): Promise<void> {
    try {
      const kernels = (await this.scene.loadKernels())();
      const [index] = [...this.index.viewTables].find(([, table]) => table === segment)!;
      this.poseRatios.setTable(index, readViewTable(kernels, payload, index.contribution.length));
      this.pathRatios = undefined;
      this.chooseSoon();
    } catch (error) {
      this.abandon(error, [segment]);
    }
  }

  /** Count a segment that cannot be fetched as arrived; after a lost head, yield the chunk's children without it. */
  protected override onLost(segment: number): void {
    const unit = this.units.of(segment);
    this.arrived.add(unit);
    const { row, isHead } = this.units.units[unit]!;
    if (isHead && segment >= 0) this.onUndecodable(this.index.rows.chunks[row]!);
  }

  /** Mark a chunk as lost and yield its decoded children without it. */
  protected override onUndecodable(chunk: number): void {
    this.lost.add(chunk);
    this.yieldChildren(chunk);
  }

  /** Queue rows for the caller after the rows of the parent chunk; drop rows of a chunk evicted meanwhile. */
  protected override onDecoded(rows: ChunkRows): void {
    const { chunk } = rows;
    this.chooseSoon();
    if (!this.isHeld(chunk)) return;
    const parent = this.index.rows.parentOf(chunk);
    if (parent >= 0 && !this.yielded.has(parent) && !this.lost.has(parent)) {
      this.early.set(chunk, rows);
      return;
    }
    this.early.delete(chunk);
    this.push({ kind: "rows", ...rows });
    if (this.yielded.has(chunk)) return;
    this.yielded.add(chunk);
    this.yieldChildren(chunk);
  }

  /** Queue the decoded rows that waited for a chunk. */
  private yieldChildren(chunk: number): void {
    for (const rows of [...this.early.values()]) {
      if (this.index.rows.parentOf(rows.chunk) === chunk) this.onDecoded(rows);
    }
  }

  /** Return whether the head of a chunk has arrived and is not evicted. */
  private isHeld(chunk: number): boolean {
    const units = this.units.ofRow(this.index.rows.rowOf(chunk)!);
    return units.some((unit) => this.units.units[unit]!.isHead && this.arrived.has(unit));
  }

  /** Drop all bytes and rows of a chunk, or a page on its way; if the rows were yielded, yield their eviction. */
  private evict(row: number, worth: number): void {
    this.evicted.set(row, { worth, until: performance.now() / 1000 + EVICTED_SECONDS });
    for (const unit of this.units.ofRow(row)) {
      const { segment } = this.units.units[unit]!;
      this.arrived.delete(unit);
      this.uncancellable.delete(segment);
      this.requests.forget(segment);
    }
    const { chunks, pages } = this.index.rows;
    if (pages[row] !== undefined) return;
    const chunk = chunks[row]!;
    this.queue.close(chunk);
    this.early.delete(chunk);
    if (this.yielded.delete(chunk)) this.push({ kind: "evicted", chunk });
  }
}
