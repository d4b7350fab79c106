import type { Pinhole } from "../container/pinhole.js";
import type { ByteRange } from "../container/scene_index.js";
import { CogsplatError, SourceError } from "../errors.js";
import { loadKernels } from "../kernels/load.js";
import type { Answer, ByteSource, ReadOptions } from "../loader/byte_source.js";
import { folders } from "../loader/folders.js";
import type { ChunkUpdate } from "../loader/stream_options.js";
import { type OpenOptions, StreamedScene, sourceOf } from "../loader/streamed_scene.js";
import { Visit } from "../loader/visit.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import { fade, type PackedSplats } from "../scene/packed_splats.js";
import type { Pose } from "../schedule/poses.js";
import { type ChunkService, SlicedService } from "../workers/decode_task.js";
import { DecoderPool } from "../workers/decoder_pool.js";
import { EndingChunks } from "./ending_chunks.js";
import { LevelOpacities } from "./level_opacities.js";
import { levelForSize, levelOfPrefix } from "./levels.js";
import { type Meter, MeteredSource } from "./meter.js";
import type { DescriptionSource, FeedHost, FeedProgress, Prefix, SceneFeed } from "./scene_feed.js";
import type { SplatLayer } from "./splat_layer.js";
import type { AllowedWorkers } from "./viewer_workers.js";
import { VisitedScene } from "./visited_scene.js";

/** Fetch order: that of the file or of the view; undefined chooses the view for files cut into cells. */
export type FetchOrder = "file" | "view" | undefined;

/** Fills a layer from a COGS file while it is fetched. */
export class CogsFeed implements SceneFeed {
  readonly progressive = true;
  private scene: StreamedScene | undefined;
  private layer: SplatLayer | undefined;
  private host: FeedHost | undefined;
  private signal: AbortSignal | undefined;
  /** First row and number of rows of each chunk received. */
  private readonly rowsOf = new Map<number, { readonly firstRow: number; readonly count: number }>();
  private splats = 0;
  private prefix = 0;
  /** First error of a segment that could not be fetched or decoded. */
  private damage: unknown;
  /** Chunks drawn with compensation. */
  private readonly shifted = new Set<number>();
  /** Prefix of the present compensation, and chunks that still need theirs. */
  private compensatedFor = -1;
  private waiting: number[] = [];
  private shown: Prefix | undefined;
  /** Chunks that end (SPEC 5.10), without fading. */
  private readonly temporary = new Map<number, PackedSplats>();
  private readonly ending = new EndingChunks(
    (chunk, prefix) => this.scene!.index.isDrawn(chunk, prefix),
    (chunk, factor) => this.drawFaded(chunk, factor),
  );
  private readonly opacities = new LevelOpacities();
  /** Coarser one of the two levels whose opacities the layer has. */
  private coarser = 0;
  /** Visit of a scene fetched in the order of the view, and its rows in the layer. */
  private visit: Visit | undefined;
  private visited: VisitedScene | undefined;
  private pose: Pose | undefined;

  /**
   * @param source - A URL, a file or another source of bytes.
   * @param meter - Counts the bytes received.
   * @param workers - Workers for decoding; without them chunks are decoded on this thread, one per task.
   * @param mostSplats - Splats held at most: chunks beyond are not fetched, or in view order evict others.
   */
  constructor(
    private readonly source: string | Blob | ByteSource,
    private readonly meter: Meter,
    private readonly workers: AllowedWorkers,
    private readonly mostSplats: number,
    private readonly order: FetchOrder,
  ) {}

  get firstView(): Pinhole | undefined {
    return this.scene?.info.firstView;
  }

  get descriptionSource(): DescriptionSource | undefined {
    const { scene, signal } = this;
    if (scene?.index.description === undefined || signal === undefined) return undefined;
    return {
      signal,
      description: () => scene.description(signal),
      picture: (name) => scene.picture(name, signal),
    };
  }

  async run(host: FeedHost, signal: AbortSignal): Promise<void> {
    this.host = host;
    this.signal = signal;
    const source = (fresh: boolean): ByteSource => new MeteredSource(sourceOf(this.source, { fresh }), this.meter);
    try {
      await this.stream(source(false), signal);
    } catch (error) {
      if (!(error instanceof CogsplatError) || error.code !== "source-changed" || signal.aborted) throw error;
      // The file was replaced while it was read: the new one is shown, bypassing caches; a second change ends it.
      this.reset();
      await this.stream(source(true), signal);
    }
  }

  /** Reset to an empty scene. */
  private reset(): void {
    this.rowsOf.clear();
    this.shifted.clear();
    this.temporary.clear();
    this.ending.clear();
    this.opacities.clear();
    [this.splats, this.prefix, this.compensatedFor, this.coarser] = [0, 0, -1, 0];
    this.waiting = [];
    this.shown = this.damage = this.scene = this.layer = this.visit = this.visited = undefined;
    this.meter.reset();
  }

  private readonly service = async (index: DecoderIndex): Promise<ChunkService> => {
    const { workers } = this;
    const allowed = await workers.found;
    if (allowed === undefined) return new SlicedService(index, await loadKernels());
    return new DecoderPool(index, { running: workers.takeRunning(allowed) });
  };

  private async stream(source: ByteSource, signal: AbortSignal): Promise<void> {
    const options: OpenOptions = { signal, service: this.service, folders };
    const scene = await StreamedScene.open(source, options).catch((error: unknown) => {
      // A truncated file is shown up to its end.
      if (!(error instanceof CogsplatError) || error.code !== "file-truncated") throw error;
      this.damage = error;
      this.meter.reset();
      return StreamedScene.open(new CutSource(source, error), options);
    });
    signal.throwIfAborted();
    this.scene = scene;
    const { info } = scene;
    await this.workers.found;
    signal.throwIfAborted();
    this.layer = this.host!.begin(
      { ...info, linear: info.colourSpace === "linear", hasLevels: info.levels.length > 0 },
      info,
    );
    this.reportProgress();
    if (this.usesViewOrder(scene)) await this.runVisit(scene, signal);
    else await this.streamAll(scene, signal);
    this.reportProgress();
    // All other chunks are shown by now.
    if (this.damage !== undefined) throw this.damage as Error;
  }

  private async streamAll(scene: StreamedScene, signal: AbortSignal): Promise<void> {
    const stream = scene.stream({
      signal,
      format: "packed",
      compensate: true,
      ending: true,
      splatBudget: Math.min(this.layer!.capacity, this.mostSplats),
      onDamage: (error) => (this.damage ??= error),
    });
    for await (const update of stream) this.applyUpdate(update);
  }

  /** Return whether to fetch by the view; scenes with levels or chunks that end need the order of the file. */
  private usesViewOrder({ answersRanges, index, info }: StreamedScene): boolean {
    const { cell, until } = index.chunks;
    const isAsked =
      this.order === "view" || (this.order === undefined && cell.length > 0 && cell.every((number) => number > 0));
    return isAsked && answersRanges && info.levels.length === 0 && until.every((end) => end === 0);
  }

  private async runVisit(scene: StreamedScene, signal: AbortSignal): Promise<void> {
    const host = this.host!;
    const layer = this.layer!;
    const visited = new VisitedScene(scene, layer, this.shifted, () => this.visit?.ratios());
    this.visited = visited;
    const visit = await Visit.begin(scene, {
      signal,
      format: "packed",
      compensate: true,
      splatBudget: Math.min(layer.capacity, this.mostSplats),
      onDamage: (error) => (this.damage ??= error),
      onSettled: (isSettled) => {
        host.settled(isSettled);
        if (isSettled && this.damage !== undefined) host.damaged(this.damage);
      },
    });
    this.visit = visit;
    if (this.pose !== undefined) visit.setPose(this.pose);
    for await (const change of visit.changes()) {
      if (change.kind === "rows") host.rowsArrived(change.packed!, visited.splats === 0);
      visited.apply(change);
      this.splats = visited.splats;
      this.reportProgress();
    }
    // The scene is complete with every chunk in its own rows, as after a fetch in file order.
    const { index } = scene;
    for (let chunk = 0; chunk < index.chunkCount; chunk++) {
      this.rowsOf.set(chunk, { firstRow: index.rows.splatsBefore(chunk)!, count: index.chunks.splats[chunk]! });
    }
    this.prefix = index.chunkCount;
    this.visit = this.visited = undefined;
  }

  setPose(pose: Pose): void {
    this.pose = pose;
    this.visit?.setPose(pose);
    this.visited?.poseChanged();
  }

  setSplatBudget(splats: number): boolean {
    this.visit?.setSplatBudget(Math.min(splats, this.layer!.capacity));
    return this.visit !== undefined;
  }

  work(milliseconds: number): boolean {
    const { scene, layer } = this;
    if (scene === undefined || layer === undefined) return false;
    if (this.visited !== undefined) return this.visited.work(performance.now() + milliseconds);
    const fades = this.ending.work(performance.now());
    const prefix = this.drawnPrefix;
    if (prefix !== this.compensatedFor && this.waiting.length === 0) {
      this.compensatedFor = prefix;
      if (prefix === scene.index.totalChunkCount) layer.compensated = false;
      else this.waiting = Array.from({ length: prefix }, (_, chunk) => chunk).reverse();
    }
    const end = performance.now() + milliseconds;
    while (this.waiting.length > 0) {
      if (performance.now() > end) return true;
      const chunk = this.waiting.pop()!;
      const rows = this.rowsOf.get(chunk);
      if (rows === undefined) continue;
      const shifts = scene.compensation.shifts(this.compensatedFor, chunk);
      if (shifts === undefined && !this.shifted.has(chunk)) continue;
      layer.shift(rows.firstRow, rows.count, shifts);
      if (shifts === undefined) this.shifted.delete(chunk);
      else {
        this.shifted.add(chunk);
        layer.compensated = true;
      }
    }
    return fades || prefix !== this.compensatedFor;
  }

  drawLevel(focal: number, chosen: number | undefined): number | undefined {
    const { scene, layer } = this;
    if (scene === undefined || layer === undefined || scene.info.levels.length === 0) return undefined;
    const { levels, firstView } = scene.info;
    const finest = levels.length - 1;
    const bySize = firstView === undefined ? finest : levelForSize(levels, focal / firstView.fy);
    const level = Math.min(Math.max(chosen ?? bySize, 0), levelOfPrefix(levels, this.drawnPrefix));
    const coarser = Math.min(Math.floor(level), Math.max(finest - 1, 0));
    layer.between = level - coarser;
    if (coarser !== this.coarser) {
      this.coarser = coarser;
      for (const chunk of this.opacities.known) this.writeLevels(chunk);
    }
    return level;
  }

  /** Number of chunks of the prefix drawn. */
  private get drawnPrefix(): number {
    return this.shown?.chunks ?? this.prefix;
  }

  private writeLevels(chunk: number, factor = 1): void {
    this.layer!.writeLevels(this.opacities.words(chunk, this.coarser, factor), this.rowsOf.get(chunk)!.firstRow);
  }

  prefixes(count: number): Prefix[] {
    const { scene } = this;
    if (scene === undefined) return [];
    const { index } = scene;
    const found: Prefix[] = [];
    let rows = 0;
    let bytes = index.range(0)?.offset ?? 0;
    for (let chunk = 0; chunk < this.prefix; chunk++) {
      rows += index.chunks.splats[chunk]!;
      const { head, refinement, tail } = index.chunkSegments(chunk);
      for (const segment of [head, refinement, tail]) if (segment >= 0) bytes += index.range(segment).length;
      found.push({ rows, chunks: chunk + 1, bytes, predictedDb: knownQuality(index.chunks.quality[chunk]) });
    }
    const end = found.pop();
    if (end === undefined) return [];
    const last = end.chunks === index.totalChunkCount ? { ...end, bytes: index.fileLength } : end;
    found.push(last);
    // Each picture has half the bytes of the next one.
    const chosen = new Set([last]);
    for (let share = 0.5; chosen.size < Math.min(count, found.length) && share > 1e-4; share /= 2) {
      chosen.add(found.find((prefix) => prefix.bytes >= share * last.bytes)!);
    }
    return [...chosen].sort((a, b) => a.rows - b.rows);
  }

  show(prefix: Prefix | undefined): void {
    this.shown = prefix;
    this.waiting = [];
    this.compensatedFor = -1;
    this.layer?.limit(prefix?.rows ?? Infinity);
    this.ending.show(this.drawnPrefix, undefined);
  }

  /** Draw a chunk that ends with its opacities multiplied by a factor. */
  private drawFaded(chunk: number, factor: number): void {
    const { packed, firstRow } = { packed: this.temporary.get(chunk)!, ...this.rowsOf.get(chunk)! };
    if (this.layer!.scene.hasLevels) this.writeLevels(chunk, factor);
    this.layer!.repaint(factor === 1 ? packed : fade(packed, factor), firstRow);
  }

  private applyUpdate(update: ChunkUpdate): void {
    const { chunk, packed, firstRow, count } = update;
    const first = this.rowsOf.size === 0;
    const isNew = !this.rowsOf.has(chunk);
    if (isNew) this.splats += count;
    this.rowsOf.set(chunk, { firstRow, count });
    this.prefix = update.prefix;
    this.host!.rowsArrived(packed!, first);
    const { index } = this.scene!;
    const { hasLevels } = this.layer!.scene;
    const drawnBy = hasLevels ? index.levelsOf(chunk) : [];
    // Chunks that some levels do not draw are hidden by their opacities there.
    const ends = index.chunks.until[chunk]! > 0 && drawnBy.length === 0;
    if (ends) this.temporary.set(chunk, copyPacked(packed!));
    if (hasLevels) {
      this.opacities.put(chunk, drawnBy, packed!.opacities!);
      this.writeLevels(chunk);
    }
    this.layer!.write(packed!, firstRow);
    if (ends) this.ending.put(chunk, this.drawnPrefix);
    this.ending.show(this.drawnPrefix, this.shown === undefined ? performance.now() : undefined);
    // A new chunk is drawn with its compensation at once.
    if (isNew && this.compensatedFor >= 0) this.compensatedFor = Math.min(this.compensatedFor, this.prefix - 1);
    this.reportProgress();
  }

  private reportProgress(): void {
    const { index } = this.scene!;
    const progress: FeedProgress = {
      splats: this.splats,
      totalSplats: index.scene.splats,
      bytes: Math.min(this.meter.bytes, index.fileLength),
      totalBytes: index.fileLength,
      predictedDb: this.prefix > 0 ? knownQuality(index.chunks.quality[this.prefix - 1]) : undefined,
    };
    this.host!.progressed(progress);
  }
}

/** Return a copy of packed splats, because a layer transfers the means of its rows to the sorter. */
function copyPacked(packed: PackedSplats): PackedSplats {
  return { ...packed, means: packed.means.slice() };
}

/** Return a predicted quality; 0 in the file means none (SPEC 5.4). */
function knownQuality(quality: number | undefined): number | undefined {
  return quality === undefined || quality === 0 ? undefined : quality;
}

/** Present bytes of a truncated file, of unknown length; a read behind its end fails with its error. */
class CutSource implements ByteSource {
  /** @param error - Error of the truncated file, at the offset of its end. */
  constructor(
    private readonly source: ByteSource,
    private readonly error: CogsplatError,
  ) {}

  async read({ offset, length }: ByteRange, options?: ReadOptions): Promise<Answer> {
    const present = (this.error.offset ?? Infinity) - offset;
    if (present <= 0) throw this.error;
    return { ...(await this.source.read({ offset, length: Math.min(length, present) }, options)), total: undefined };
  }

  relative(name: string): ByteSource {
    if (this.source.relative === undefined) throw new SourceError(`${name} cannot be reached`, undefined, false);
    return this.source.relative(name);
  }
}
