import type { Index, Page, SceneIndex } from "../container/scene_index.js";
import { SegmentKind } from "../container/tables.js";
import { LEAST_USUAL } from "../schedule/chunk_ratios.js";
import type { Unit } from "../schedule/unit_links.js";

/** Part of an index that units are made from. */
export type UnitIndex = Pick<SceneIndex, "indexes" | "rows" | "segments" | "chunks" | "codebookSegmentsOf">;

/** A unit of the scheduler. */
export interface SegmentUnit extends Unit {
  /** Its segment; −1 − n for page n of `SceneIndex.pages`. */
  readonly segment: number;
}

const OF_CHUNKS: readonly number[] = [SegmentKind.head, SegmentKind.refinement, SegmentKind.tail];
const BANDS: readonly number[] = [SegmentKind.colourBand1, SegmentKind.colourBand2, SegmentKind.colourBand3];

/**
 * Segments that pictures need and unread pages, as units of the scheduler (docs/streaming.md, 7): those of each index as
 * it is read.
 *
 * Chunks that end (SPEC 5.10) are excluded, as in every order but that of the file (SPEC 8.6).
 */
export class SegmentUnits {
  readonly units: SegmentUnit[] = [];
  /** Splats of each row; an unread page counts as much as a chunk below it on average. */
  readonly splats: number[] = [];
  /** Contribution of each row. */
  readonly contribution: number[] = [];
  private readonly unitOf = new Map<number, number>();
  /** Units of each row. */
  private readonly ofRows: number[][] = [];
  private readonly heads = new Map<number, number>();
  /** Contributions of all that the root lists, above 0. */
  private readonly picture: number;
  private entered = 0;

  /**
   * @param degree - SH degree to fetch.
   * @param compensates - Whether to fetch the layers of compensation.
   */
  constructor(
    private readonly index: UnitIndex,
    private readonly degree: number,
    private readonly compensates: boolean,
  ) {
    this.picture = index.indexes[0]!.contribution.reduce((sum, value) => sum + value, 0) || 1;
  }

  /** Whether an index was read that is not entered. */
  get isBehind(): boolean {
    return this.entered < this.index.indexes.length;
  }

  /**
   * Enter the indexes that were read since the last call; other units keep their numbers.
   *
   * @returns Units of the pages among them.
   */
  enter(): number[] {
    const read: number[] = [];
    for (; this.entered < this.index.indexes.length; this.entered++) {
      const index = this.index.indexes[this.entered]!;
      const { page } = index;
      this.enterSegments(index);
      for (const listed of index.pages) this.enterPage(listed);
      if (page === undefined) continue;
      // The rows of a page replace it.
      const unit = this.of(-1 - page.number);
      this.units[unit] = { ...this.units[unit]!, row: -1, isHead: false, dependencies: [] };
      this.heads.delete(page.row);
      this.ofRows[page.row] = [];
      read.push(unit);
    }
    return read;
  }

  /** Return the unit of a segment or page. */
  of(segment: number): number {
    return this.unitOf.get(segment)!;
  }

  /** Return the units of a row. */
  ofRow(row: number): readonly number[] {
    return this.ofRows[row] ?? [];
  }

  private enterSegments(index: Index): void {
    const { kind, owner, length } = this.index.segments;
    const { rows } = this.index;
    const numbers = Array.from({ length: index.segmentCount }, (_, i) => index.firstSegment + i);
    const wanted = numbers.filter((segment) => this.isWanted(segment));
    const rowOf = (segment: number): number => (OF_CHUNKS.includes(kind[segment]!) ? rows.rowOf(owner[segment]!)! : -1);
    for (const [i, segment] of wanted.entries()) {
      this.unitOf.set(segment, this.units.length + i);
      if (kind[segment] === SegmentKind.head) this.heads.set(rowOf(segment), this.units.length + i);
    }
    const gains = this.gainsOf(index, numbers);
    for (const segment of wanted) {
      const row = rowOf(segment);
      const isHead = kind[segment] === SegmentKind.head;
      const books = row < 0 ? [] : this.index.codebookSegmentsOf(segment, this.degree);
      const before = this.heads.get(isHead ? rows.parents[row]! : row);
      const dependencies = [...books.map((book) => this.unitOf.get(book)), before].filter((unit) => unit !== undefined);
      const gain = gains[segment - index.firstSegment]!;
      this.push({ segment, row, isHead, gain, size: length[segment]!, dependencies });
    }
    for (let i = 0; i < index.chunkCount; i++) {
      this.splats.push(rows.splats[index.firstRow + i]!);
      this.contribution.push(index.contribution[i]!);
    }
  }

  /** Return the gain of each segment of an index, in the unit of contributions (docs/streaming.md, 7). */
  private gainsOf(index: Index, numbers: readonly number[]): number[] {
    const { kind, owner, offset, length } = this.index.segments;
    const { firstChunk, contribution, start, page } = index;
    const endOf = (segment: number): number => offset[segment]! - start + length[segment]!;
    const begin = offset[index.firstSegment]! - start;
    const headOf = new Map<number, number>();
    for (const segment of numbers) if (kind[segment] === SegmentKind.head) headOf.set(owner[segment]!, segment);
    let last: number | undefined;
    return numbers.map((segment) => {
      const of = kind[segment]!;
      if (of === SegmentKind.head) last = segment;
      // It decides the order of all others, so it counts as the whole picture.
      if (of === SegmentKind.viewTable) return this.picture;
      const end = endOf(segment);
      if (page === undefined) return this.picture * (begin / end) * (length[segment]! / end);
      // Segments of no chunk count like the chunk whose head precedes them.
      const head = OF_CHUNKS.includes(of) ? headOf.get(owner[segment]!) : last;
      if (head === undefined) return 0;
      const closeness = endOf(head) / end;
      const share = this.gained(contribution[owner[head]! - firstChunk]!);
      return share * (length[segment]! / length[head]!) * (closeness * closeness);
    });
  }

  /** Return a contribution above 0. */
  private gained(contribution: number): number {
    return Math.max(contribution, LEAST_USUAL * this.picture);
  }

  private enterPage(page: Page): void {
    const parent = this.heads.get(this.index.rows.parents[page.row]!);
    const segment = -1 - page.number;
    this.unitOf.set(segment, this.units.length);
    this.heads.set(page.row, this.units.length);
    this.push({
      segment,
      row: page.row,
      isHead: true,
      gain: this.gained(page.contribution),
      size: page.length,
      dependencies: parent === undefined ? [] : [parent],
    });
    this.splats.push(Math.ceil(page.splats / Math.max(page.chunks, 1)));
    this.contribution.push(page.contribution);
  }

  private push(unit: SegmentUnit): void {
    if (unit.row >= 0) {
      this.ofRows[unit.row] ??= [];
      this.ofRows[unit.row]!.push(this.units.length);
    }
    this.units.push(unit);
  }

  /** Return whether pictures of the degree need a segment. */
  private isWanted(segment: number): boolean {
    const { kind, owner } = this.index.segments;
    const of = kind[segment]!;
    if (OF_CHUNKS.includes(of)) {
      return this.index.chunks.until[owner[segment]!] === 0 && (of !== SegmentKind.tail || this.degree > 0);
    }
    if (of === SegmentKind.compensation) return this.compensates;
    return of === SegmentKind.shapeCodebook || of === SegmentKind.viewTable || BANDS.slice(0, this.degree).includes(of);
  }
}
