import type { SceneIndex } from "../container/scene_index.js";
import type { PackRanges } from "../scene/packed_splats.js";
import type { ChunkFormat, ChunkService } from "../workers/decode_task.js";
import { KeptHeads, withBands } from "./kept_heads.js";
import type { ChunkUpdate } from "./stream_options.js";

/** What is decoded and how. */
export interface DecodeOptions {
  readonly degree: number;
  readonly format: ChunkFormat;
  readonly ranges: PackRanges;
  readonly refine: boolean;
  /** Level whose opacities are wanted (SPEC 5.11); undefined for those of one level after the other, as they come. */
  readonly level?: number | undefined;
}

/** Which payloads of a chunk were in its last update. */
interface Given {
  readonly tail: boolean;
  readonly refined: boolean;
  /** Of how many later levels opacities were there. */
  readonly opacities: number;
}

/**
 * Collects the payloads of chunks and decodes each chunk when its head and the codebooks that it needs are there, and
 * again when its refinement has come; of a tail that comes later the coefficients alone are decoded, where what the head
 * was decoded to could be kept.
 */
export class ChunkQueue {
  private readonly heads = new KeptHeads();
  private readonly payloads = new Map<number, Uint8Array>();
  private readonly codebooks = new Set<number>();
  /** Segments that cannot be had. */
  private readonly lost = new Set<number>();
  private readonly given = new Map<number, Given>();
  private readonly decoding = new Set<number>();
  /** Chunks that were not yet given with all that they have. */
  private readonly open = new Set<number>();

  constructor(
    private readonly index: SceneIndex,
    private readonly service: ChunkService,
    private readonly options: DecodeOptions,
    private readonly emit: (update: Omit<ChunkUpdate, "prefix">) => void,
    private readonly fail: (error: unknown, chunk: number) => void,
  ) {}

  /** Keep no more than so many bytes of decoded heads whose tails are still to come. */
  keepAtMost(bytes: number): void {
    this.heads.keepAtMost(bytes);
  }

  /** Bytes of decoded heads whose tails are still to come. */
  get keptBytes(): number {
    return this.heads.bytes;
  }

  /** Chunks from here on are decoded as their payloads come. */
  expect(chunk: number): void {
    this.open.add(chunk);
  }

  /** The segments that the expected chunks still need, by chunk. */
  allMissing(): number[] {
    return [...this.open].flatMap((chunk) => this.missing(chunk));
  }

  /** The segments that a chunk still needs, in the order in which they help most. */
  private missing(chunk: number): number[] {
    const { head, refinement, tail } = this.index.chunkSegments(chunk);
    const { degree, refine } = this.options;
    const books = (segment: number, upTo: number) => this.index.codebookSegmentsOf(segment, upTo) ?? [];
    const wanted = [...books(head, 0), head];
    if (refine && refinement >= 0) wanted.push(refinement);
    wanted.push(...this.opacities(chunk));
    if (degree > 0 && tail >= 0) wanted.push(...books(tail, degree), tail);
    return wanted.filter((segment) => !this.has(segment) && !this.lost.has(segment));
  }

  /** The segments of opacities that are wanted of a chunk. */
  private opacities(chunk: number): readonly number[] {
    const { level } = this.options;
    if (level === undefined) return this.index.chunkSegments(chunk).opacities;
    const segment = this.index.opacitiesAt(chunk, level);
    return segment === undefined ? [] : [segment];
  }

  /** The opacities of a chunk that have come: of packed chunks those of all levels, else the last. */
  private opacitiesHere(chunk: number): {
    readonly count: number;
    readonly payloads: readonly (Uint8Array | undefined)[] | undefined;
  } {
    const { format, level } = this.options;
    const all = this.opacities(chunk).map((segment) => this.payloads.get(segment));
    const here = all.filter((payload) => payload !== undefined);
    const ofLevels = format === "packed" && level === undefined && this.index.scene.levels.length > 0;
    return { count: here.length, payloads: ofLevels ? all : here.length > 0 ? here.slice(-1) : undefined };
  }

  /** Whether a segment has come. */
  has(segment: number): boolean {
    return this.payloads.has(segment) || this.codebooks.has(segment);
  }

  /** Take a segment whose CRC was checked. */
  add(segment: number, payload: Uint8Array): void {
    const kind = this.index.segments.kind[segment]!;
    const owner = this.index.segments.owner[segment]!;
    if (kind >= 3 && kind <= 6) {
      this.codebooks.add(segment);
      this.service.addCodebook(owner, kind, payload);
      for (const chunk of this.open) this.decode(chunk);
    } else if (this.open.has(owner)) {
      this.payloads.set(segment, payload);
      this.decode(owner);
    }
  }

  /** Go on without a segment; gives the chunks that cannot be drawn for it, or that lack something. */
  lose(segment: number): number[] {
    this.lost.add(segment);
    const touched = [...this.open].filter((chunk) => {
      const { head, refinement, tail } = this.index.chunkSegments(chunk);
      const parts = [head, refinement, tail, ...this.opacities(chunk)].filter((part) => part >= 0);
      return parts.some((part) => part === segment || this.index.codebookSegmentsOf(part, 3)?.includes(segment));
    });
    for (const chunk of touched) this.decode(chunk);
    return touched;
  }

  /** Whether every chunk that was expected has been given, or cannot be. */
  get idle(): boolean {
    return this.decoding.size === 0;
  }

  private decode(chunk: number): void {
    if (this.decoding.has(chunk) || !this.open.has(chunk)) return;
    const { head, refinement, tail } = this.index.chunkSegments(chunk);
    const { needs } = this.index.segments;
    const { degree, format, ranges } = this.options;
    if (!this.ready(head, 0)) {
      if (this.isLost(head, 0)) this.close(chunk);
      return;
    }
    const withTail = degree > 0 && tail >= 0 && this.ready(tail, degree);
    const refined = refinement >= 0 && this.payloads.has(refinement);
    const opacities = this.opacitiesHere(chunk);
    const before = this.given.get(chunk);
    // A page that is not known yet may bring a tail or a refinement.
    const final = this.index.complete && this.missing(chunk).length === 0;
    if (
      before !== undefined &&
      before.tail === withTail &&
      before.refined === refined &&
      before.opacities === opacities.count
    ) {
      if (final) this.close(chunk);
      return;
    }
    const rows = this.index.chunks.splats[chunk]!;
    this.decoding.add(chunk);
    const kept = this.heads.take(chunk);
    const tailPayload = withTail ? this.payloads.get(tail)! : undefined;
    const isTailAlone =
      kept !== undefined &&
      tailPayload !== undefined &&
      before?.refined === refined &&
      before.opacities === opacities.count;
    const payloads = isTailAlone
      ? { chunk, tail: tailPayload }
      : {
          chunk,
          head: this.payloads.get(head)!,
          tail: tailPayload,
          refinement: refined ? this.payloads.get(refinement)! : undefined,
          opacities: opacities.payloads,
        };
    this.given.set(chunk, { tail: withTail, refined, opacities: opacities.count });
    if (final) this.close(chunk);
    this.service
      .decode({
        payloads,
        rows,
        needs: { head: needs[head]!, tail: withTail ? needs[tail]! : 0 },
        degree,
        format,
        ranges,
      })
      .then(
        (decoded) => {
          this.decoding.delete(chunk);
          const firstRow = this.firstRow(chunk);
          const whole = isTailAlone ? withBands(kept, decoded.bands!) : decoded;
          if (!withTail && this.expectsTail(chunk)) this.heads.keep(chunk, whole);
          this.emit({ chunk, firstRow, count: rows, tail: withTail, refined, ...whole });
          this.decode(chunk);
        },
        (error: unknown) => {
          this.decoding.delete(chunk);
          this.close(chunk);
          this.fail(error, chunk);
        },
      );
  }

  /** Whether a chunk's tail may still come. */
  private expectsTail(chunk: number): boolean {
    const { tail } = this.index.chunkSegments(chunk);
    if (!this.open.has(chunk) || this.options.degree === 0) return false;
    return tail >= 0 ? !this.isLost(tail, this.options.degree) : !this.index.complete;
  }

  /** Whether a segment and the codebooks that it needs are there. */
  private ready(segment: number, degree: number): boolean {
    const books = this.index.codebookSegmentsOf(segment, degree);
    return this.payloads.has(segment) && (books?.every((book) => this.codebooks.has(book)) ?? false);
  }

  private isLost(segment: number, degree: number): boolean {
    const books = this.index.codebookSegmentsOf(segment, degree) ?? [];
    return [segment, ...books].some((part) => this.lost.has(part));
  }

  /** Forget a chunk's payloads: nothing more comes of it, unless it is expected again. */
  close(chunk: number): void {
    this.open.delete(chunk);
    this.heads.take(chunk);
    this.given.delete(chunk);
    const { head, refinement, tail, opacities } = this.index.chunkSegments(chunk);
    for (const segment of [head, refinement, tail, ...opacities]) this.payloads.delete(segment);
  }

  private rowStarts: Float64Array | undefined;

  private firstRow(chunk: number): number {
    const { splats } = this.index.chunks;
    if (this.rowStarts === undefined || this.rowStarts.length < splats.length) {
      this.rowStarts = new Float64Array(splats.length);
      for (let i = 1; i < splats.length; i++) this.rowStarts[i] = this.rowStarts[i - 1]! + splats[i - 1]!;
    }
    return this.rowStarts[chunk]!;
  }
}
