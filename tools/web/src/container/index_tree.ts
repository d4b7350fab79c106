import { CogsplatError } from "../errors.js";
import { crc32 } from "./crc32.js";
import { Fields } from "./fields.js";
import type { Index, Page } from "./indexes.js";
import { parseMap } from "./msgpack.js";
import { SceneRows } from "./scene_rows.js";
import {
  type ChunkTable,
  GrowingTable,
  MAX_PAGES,
  MAX_SEGMENTS,
  type PageTable,
  readChunkTable,
  readPageTable,
  readSegmentTable,
  type SegmentTable,
} from "./tables.js";

/** Pages on the path from the root to a chunk at most (SPEC 9.1). */
const MAX_DEPTH = 3;

/** Rows of segment tables with the byte offset of each segment in the file. */
export interface PlacedSegments extends SegmentTable {
  readonly offset: Float64Array;
}

/** What an index states of all that is below it. */
const SUMS = ["segments", "chunks", "span", "splats"] as const;
type Sums = Readonly<Record<(typeof SUMS)[number], number>>;

/** Tables of the root or of a page. */
export interface IndexTables {
  readonly segments: SegmentTable;
  readonly chunks: ChunkTable;
  readonly pages: PageTable | undefined;
}

/**
 * The root and the pages read so far: a tree that is read from the root down, in any order (SPEC 5.6).
 *
 * Segments and chunks have their numbers in the order of the file.
 */
export class IndexTree {
  /** The root, then the pages in the order in which they were read. */
  readonly indexes: Index[] = [];
  /** Pages that the indexes list, read or not. */
  readonly pages: Page[] = [];
  /** Chunks and pages as rows of one table. */
  readonly rows = new SceneRows();
  /** Segments, chunks and splats of the file, and its end, as the root states them. */
  readonly total: Sums;
  readonly end: number;
  private readonly segmentTable: GrowingTable<PlacedSegments>;
  private readonly chunkTable: GrowingTable<ChunkTable>;
  /** Path to the next page in the order of the file: each index with the number of its pages passed. */
  private readonly path: { readonly index: Index; passed: number }[];

  /**
   * @param root - Tables of the root.
   * @param rootEnd - End of the root, bytes.
   */
  constructor(root: IndexTables, rootEnd: number) {
    this.segmentTable = new GrowingTable(placed(root.segments, rootEnd), root.segments.kind.length);
    this.chunkTable = new GrowingTable(root.chunks, root.chunks.splats.length);
    this.total = sumsOf(root);
    this.end = rootEnd + this.total.span;
    this.path = [{ index: this.enter(root, undefined, rootEnd), passed: 0 }];
  }

  /** Refuse more segments than a file may have. */
  protected checkCount(): void {
    const { segments } = this.total;
    if (segments > MAX_SEGMENTS) throw new CogsplatError("segment-count", `${segments} segments`);
  }

  get root(): Index {
    return this.indexes[0]!;
  }

  /** Rows of the segment tables by segment number; zeros for segments of unread pages. */
  get segments(): PlacedSegments {
    return this.segmentTable.table;
  }

  /** Rows of the chunk tables by chunk number; zeros for chunks of unread pages. */
  get chunks(): ChunkTable {
    return this.chunkTable.table;
  }

  /** Whether all pages are read. */
  get complete(): boolean {
    return this.indexes.length > this.pages.length;
  }

  /** Whether a page was read. */
  isRead(page: Page): boolean {
    return this.rows.indexOf(page) !== undefined;
  }

  /** Return the first unread page in the order of the file; undefined where all are read. */
  nextPage(): Page | undefined {
    for (let last = this.path.at(-1); last !== undefined; last = this.path.at(-1)) {
      const page = last.index.pages[last.passed];
      const index = page && this.rows.indexOf(page);
      if (page !== undefined && index === undefined) return page;
      if (index === undefined) this.path.pop();
      else {
        last.passed++;
        this.path.push({ index, passed: 0 });
      }
    }
    return undefined;
  }

  /** Number of chunks before the first unread page. */
  get chunkCount(): number {
    return this.nextPage()?.firstChunk ?? this.total.chunks;
  }

  /** Number of chunks of the whole file. */
  get totalChunkCount(): number {
    return this.total.chunks;
  }

  /** Check the bytes of a page and read their tables. */
  readPage(page: Page, bytes: Uint8Array): IndexTables {
    const where = `page ${page.number}`;
    if (crc32(bytes) !== page.crc)
      throw new CogsplatError("page-crc", `the CRC of ${where} does not match`, page.offset);
    const fields = new Fields(parseMap(bytes), where);
    const isDeepest = page.listedBy.depth + 1 === MAX_DEPTH;
    const pages = fields.has("pages") ? readPageTable(fields.fields("pages"), isDeepest ? 0 : MAX_PAGES) : undefined;
    const tables = {
      pages,
      segments: readSegmentTable(fields.fields("segments")),
      chunks: readChunkTable(fields.fields("chunks")),
    };
    fields.finish();
    const found = sumsOf(tables);
    const wrong = SUMS.find((key) => found[key] !== page[key]);
    if (wrong !== undefined) {
      const message = `${where}: ${found[wrong]} ${wrong}, expected ${page[wrong]} as the index above states`;
      throw new CogsplatError("page-entry", message, page.offset);
    }
    return tables;
  }

  /** Enter the tables of an unread page. */
  enterPage(page: Page, tables: IndexTables): Index {
    return this.enter(tables, page, page.offset + page.length);
  }

  /** Enter an index whose segments begin at a byte. */
  private enter({ segments, chunks, pages }: IndexTables, page: Page | undefined, begin: number): Index {
    const firstSegment = page?.firstSegment ?? 0;
    const firstChunk = page?.firstChunk ?? 0;
    const [ownSegments, ownChunks] = [segments.kind.length, chunks.splats.length];
    const end = begin + sum(segments.length);
    this.segmentTable.put(firstSegment, placed(segments, begin), ownSegments);
    this.chunkTable.put(firstChunk, chunks, ownChunks);
    const listed: Page[] = [];
    const index: Index = {
      page,
      depth: page === undefined ? 0 : page.listedBy.depth + 1,
      start: page?.offset ?? 0,
      segmentsEnd: end,
      firstSegment,
      segmentCount: ownSegments,
      firstChunk,
      chunkCount: ownChunks,
      pages: listed,
      firstRow: this.rows.count,
      boxes: joined(Float32Array, chunks.box, pages?.box),
      contribution: joined(Float64Array, chunks.contribution, pages?.contribution),
    };
    this.indexes.push(index);
    let segment = firstSegment + ownSegments;
    let chunk = firstChunk + ownChunks;
    let splat = (page?.firstSplat ?? 0) + sum(chunks.splats);
    let offset = end;
    for (let i = 0; pages !== undefined && i < pages.length.length; i++) {
      const entry: Page = {
        number: this.pages.length,
        offset,
        length: pages.length[i]!,
        crc: pages.crc[i]!,
        segments: pages.segments[i]!,
        chunks: pages.chunks[i]!,
        span: pages.span[i]!,
        splats: pages.splats[i]!,
        contribution: pages.contribution[i]!,
        firstSegment: segment,
        firstChunk: chunk,
        firstSplat: splat,
        row: index.firstRow + ownChunks + i,
        listedBy: index,
      };
      listed.push(entry);
      this.pages.push(entry);
      segment += entry.segments;
      chunk += entry.chunks;
      splat += entry.splats;
      offset += entry.length + entry.span;
    }
    this.rows.enter(index, chunks, pages?.cell ?? []);
    return index;
  }
}

/** Return what the tables of an index say of all that is below it. */
function sumsOf({ segments, chunks, pages }: IndexTables): Sums {
  return {
    segments: segments.kind.length + sum(pages?.segments ?? []),
    chunks: chunks.splats.length + sum(pages?.chunks ?? []),
    splats: sum(chunks.splats) + sum(pages?.splats ?? []),
    span: sum(segments.length) + sum(pages?.length ?? []) + sum(pages?.span ?? []),
  };
}

/** Add the byte offset of each segment, the first at `begin`. */
function placed(table: SegmentTable, begin: number): PlacedSegments {
  let end = begin;
  const offset = Float64Array.from(table.length, (length) => {
    end += length;
    return end - length;
  });
  return { ...table, offset };
}

function sum(numbers: Iterable<number>): number {
  let total = 0;
  for (const number of numbers) total += number;
  return total;
}

function joined<T extends Float32Array | Float64Array>(
  type: new (length: number) => T,
  first: T,
  second: T | undefined,
): T {
  const all = new type(first.length + (second?.length ?? 0));
  all.set(first);
  if (second !== undefined) all.set(second, first.length);
  return all;
}
