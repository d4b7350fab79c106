import type { SceneIndex } from "../container/scene_index.js";
import type { PackRanges } from "../scene/packed_splats.js";
import type { ChunkFormat, ChunkService } from "../workers/decode_task.js";
import { KeptHeads, withBands } from "./kept_heads.js";
import type { ChunkUpdate } from "./stream_options.js";

/** Format and detail of decoded chunks. */
export interface DecodeOptions {
  readonly degree: number;
  readonly format: ChunkFormat;
  readonly ranges: PackRanges;
  readonly refine: boolean;
  /** Level of the opacities (SPEC 5.11); undefined for the opacities of each level as they arrive. */
  readonly level?: number | undefined;
}

/** Payloads that were part of a chunk's last update. */
interface Emitted {
  readonly tail: boolean;
  readonly refined: boolean;
  /** Number of later levels with opacities. */
  readonly opacities: number;
}

/**
 * Collects the payloads of chunks, and decodes each chunk as they become complete.
 *
 * A chunk is decoded when its head and codebooks are present, and again with its refinement. A later tail is decoded
 * alone if the decoded head was kept.
 */
export class ChunkQueue {
  private readonly heads = new KeptHeads();
  private readonly payloads = new Map<number, Uint8Array>();
  private readonly codebooks = new Set<number>();
  /** Segments that cannot be fetched. */
  private readonly lost = new Set<number>();
  private readonly emitted = new Map<number, Emitted>();
  private readonly decoding = new Set<number>();
  /** Expected chunks whose last update is still to come. */
  private readonly pending = new Set<number>();

  constructor(
    private readonly index: SceneIndex,
    private readonly service: ChunkService,
    private readonly options: DecodeOptions,
    private readonly emit: (update: Omit<ChunkUpdate, "prefix">) => void,
    private readonly fail: (error: unknown, chunk: number) => void,
  ) {}

  /** Limit the bytes of decoded heads that are kept until their tails arrive. */
  keepAtMost(bytes: number): void {
    this.heads.keepAtMost(bytes);
  }

  /** Bytes of decoded heads kept until their tails arrive. */
  get keptBytes(): number {
    return this.heads.bytes;
  }

  /** Decode a chunk as its payloads arrive from now on. */
  expect(chunk: number): void {
    this.pending.add(chunk);
  }

  /** Return the missing segments of the expected chunks, chunk by chunk. */
  allMissing(): number[] {
    return [...this.pending].flatMap((chunk) => this.missing(chunk));
  }

  /** Return the missing segments of a chunk, the most useful first. */
  private missing(chunk: number): number[] {
    const { head, refinement, tail } = this.index.chunkSegments(chunk);
    const { degree, refine } = this.options;
    const books = (segment: number, upTo: number) => this.index.codebookSegmentsOf(segment, upTo);
    const wanted = [...books(head, 0), head];
    if (refine && refinement >= 0) wanted.push(refinement);
    wanted.push(...this.opacities(chunk));
    if (degree > 0 && tail >= 0) wanted.push(...books(tail, degree), tail);
    return wanted.filter((segment) => !this.has(segment) && !this.lost.has(segment));
  }

  /** Return the segments of a chunk's opacities at the levels to decode. */
  private opacities(chunk: number): readonly number[] {
    const { level } = this.options;
    if (level === undefined) return this.index.chunkSegments(chunk).opacities;
    const segment = this.index.opacitiesAt(chunk, level);
    return segment === undefined ? [] : [segment];
  }

  /** Return the received opacities of a chunk: of all levels for packed chunks, otherwise of the last level. */
  private receivedOpacities(chunk: number): {
    readonly count: number;
    readonly payloads: readonly (Uint8Array | undefined)[] | undefined;
  } {
    const { format, level } = this.options;
    const all = this.opacities(chunk).map((segment) => this.payloads.get(segment));
    const received = all.filter((payload) => payload !== undefined);
    const ofLevels = format === "packed" && level === undefined && this.index.scene.levels.length > 0;
    return {
      count: received.length,
      payloads: ofLevels ? all : received.length > 0 ? received.slice(-1) : undefined,
    };
  }

  /** Return whether a segment has been received. */
  has(segment: number): boolean {
    return this.payloads.has(segment) || this.codebooks.has(segment);
  }

  /** Add a segment whose CRC was checked. */
  add(segment: number, payload: Uint8Array): void {
    const kind = this.index.segments.kind[segment]!;
    const owner = this.index.segments.owner[segment]!;
    if (kind >= 3 && kind <= 6) {
      this.codebooks.add(segment);
      this.service.addCodebook(owner, kind, payload);
      for (const chunk of this.pending) this.decode(chunk);
    } else if (this.pending.has(owner)) {
      this.payloads.set(segment, payload);
      this.decode(owner);
    }
  }

  /** Continue without a segment; return the chunks that lack it. */
  abandon(segment: number): number[] {
    this.lost.add(segment);
    const touched = [...this.pending].filter((chunk) => {
      const { head, refinement, tail } = this.index.chunkSegments(chunk);
      const parts = [head, refinement, tail, ...this.opacities(chunk)].filter((part) => part >= 0);
      return parts.some((part) => part === segment || this.index.codebookSegmentsOf(part, 3).includes(segment));
    });
    for (const chunk of touched) this.decode(chunk);
    return touched;
  }

  /** Whether no chunk is being decoded. */
  get idle(): boolean {
    return this.decoding.size === 0;
  }

  private decode(chunk: number): void {
    if (this.decoding.has(chunk) || !this.pending.has(chunk)) return;
    const { head, refinement, tail } = this.index.chunkSegments(chunk);
    const { needs } = this.index.segments;
    const { degree, format, ranges } = this.options;
    if (!this.isReady(head, 0)) {
      if (this.isLost(head, 0)) this.close(chunk);
      return;
    }
    const withTail = degree > 0 && tail >= 0 && this.isReady(tail, degree);
    const refined = refinement >= 0 && this.payloads.has(refinement);
    const opacities = this.receivedOpacities(chunk);
    const before = this.emitted.get(chunk);
    const final = this.missing(chunk).length === 0;
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
    const kept = this.heads.remove(chunk);
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
    this.emitted.set(chunk, { tail: withTail, refined, opacities: opacities.count });
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
          const firstRow = this.index.rows.splatsBefore(chunk)!;
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

  /** Return whether a chunk's tail may still arrive. */
  private expectsTail(chunk: number): boolean {
    const { tail } = this.index.chunkSegments(chunk);
    if (!this.pending.has(chunk) || this.options.degree === 0) return false;
    return tail >= 0 && !this.isLost(tail, this.options.degree);
  }

  /** Return whether a segment and its codebooks are received. */
  private isReady(segment: number, degree: number): boolean {
    const books = this.index.codebookSegmentsOf(segment, degree);
    return this.payloads.has(segment) && books.every((book) => this.codebooks.has(book));
  }

  private isLost(segment: number, degree: number): boolean {
    const books = this.index.codebookSegmentsOf(segment, degree);
    return [segment, ...books].some((part) => this.lost.has(part));
  }

  /** Drop the payloads of a chunk, until it is expected again. */
  close(chunk: number): void {
    this.pending.delete(chunk);
    this.heads.remove(chunk);
    this.emitted.delete(chunk);
    const { head, refinement, tail, opacities } = this.index.chunkSegments(chunk);
    for (const segment of [head, refinement, tail, ...opacities]) this.payloads.delete(segment);
  }
}
