import { CogsplatError } from "../errors.js";
import type { Fields } from "./fields.js";

/** Segment kinds of SPEC 5.2. */
export const SegmentKind = {
  head: 1,
  tail: 2,
  shapeCodebook: 3,
  colourBand1: 4,
  colourBand2: 5,
  colourBand3: 6,
  refinement: 7,
  opacities: 8,
  cameras: 128,
  attributes: 129,
  compensation: 130,
  viewTable: 131,
  description: 132,
  picture: 133,
} as const;

/** First kind of segments that a reader without support may skip. */
const FIRST_SKIPPABLE_KIND = 128;
/** Splats of a chunk at most (SPEC 5.4). */
const MAX_CHUNK_SPLATS = 262_144;
/** Pages of an index at most (SPEC 9.1). */
export const MAX_PAGES = 128;
/** Bytes of a page at most (SPEC 9.1). */
const MAX_PAGE_BYTES = 1_048_576;
/** Segments of a file at most (SPEC 9.1). */
export const MAX_SEGMENTS = 1_048_576;

/** Rows of one or more segment tables (SPEC 5.3). */
export interface SegmentTable {
  readonly kind: Uint8Array;
  readonly owner: Uint32Array;
  readonly length: Uint32Array;
  readonly crc: Uint32Array;
  /** Hashes, 16 bytes per row. */
  readonly hash: Uint8Array;
  readonly needs: Uint32Array;
}

/** Rows of one or more chunk tables (SPEC 5.4). */
export interface ChunkTable {
  readonly splats: Uint32Array;
  /** Bounding boxes, six numbers per row: minimum corner, then maximum corner. */
  readonly box: Float32Array;
  readonly contribution: Float64Array;
  readonly layer: Uint32Array;
  readonly cell: Uint32Array;
  readonly object: Uint32Array;
  readonly quality: Float32Array;
  /**
   * Number of chunks of the first prefix that no longer draws the chunk; 0 for a chunk that all prefixes draw (SPEC
   * 5.10).
   */
  readonly until: Uint32Array;
}

/** Rows of the pages that an index lists (SPEC 5.6). */
export interface PageTable {
  /** Bytes of the page, and their CRC. */
  readonly length: Uint32Array;
  readonly crc: Uint32Array;
  /** Segments and chunks below the page. */
  readonly segments: Uint32Array;
  readonly chunks: Uint32Array;
  /** Bytes of all that is below it: of its segments, and its pages with their span. */
  readonly span: Float64Array;
  /** Splats, box and contribution of the chunks below it, and a cell in which all of their cells lie. */
  readonly splats: Uint32Array;
  readonly box: Float32Array;
  readonly contribution: Float64Array;
  readonly cell: Uint32Array;
}

/** Read the field `segments` of a root or a page. */
export function readSegmentTable(fields: Fields): SegmentTable {
  const kind = Uint8Array.from(bytesOf(fields.column("kind", 1)));
  const rows = kind.length;
  const table: SegmentTable = {
    kind,
    owner: uint32Column(fields.column("owner", 4, rows)),
    length: uint32Column(fields.column("length", 4, rows)),
    crc: uint32Column(fields.column("crc", 4, rows)),
    hash: Uint8Array.from(bytesOf(fields.column("hash", 16, rows))),
    needs: uint32Column(fields.column("needs", 4, rows)),
  };
  fields.finish();
  const known = new Set<number>(Object.values(SegmentKind));
  const unknown = kind.findIndex((value) => value < FIRST_SKIPPABLE_KIND && !known.has(value));
  if (unknown >= 0) {
    throw new CogsplatError("segment-kind-unknown", `${fields.where}: segment ${unknown} is of kind ${kind[unknown]}`);
  }
  const empty = table.length.indexOf(0);
  if (empty >= 0) throw fields.outOfRange("length", `segment ${empty} has no bytes`);
  return table;
}

/** Read the field `chunks` of a root or a page. */
export function readChunkTable(fields: Fields): ChunkTable {
  const splats = uint32Column(fields.column("splats", 4));
  const rows = splats.length;
  const box = float32Column(fields.column("box", 24, rows));
  const contribution = float64Column(fields.column("contribution", 8, rows));
  const optional = (key: string) =>
    fields.has(key) ? uint32Column(fields.column(key, 4, rows)) : new Uint32Array(rows);
  const table: ChunkTable = {
    splats,
    box,
    contribution,
    layer: optional("layer"),
    cell: optional("cell"),
    object: optional("object"),
    quality: fields.has("quality") ? float32Column(fields.column("quality", 4, rows)) : new Float32Array(rows),
    until: optional("until"),
  };
  fields.finish();
  checkRange(fields, "splats", splats, 1, MAX_CHUNK_SPLATS);
  checkBoxes(fields, box);
  checkContribution(fields, contribution);
  const wrong = table.quality.findIndex((quality) => !(quality >= 0 && quality <= 100));
  if (wrong >= 0) throw fields.outOfRange("quality", `row ${wrong} has ${table.quality[wrong]} dB`);
  return table;
}

/**
 * Read the field `pages` of a root or a page.
 *
 * @param most - Number of rows at most.
 */
export function readPageTable(fields: Fields, most: number): PageTable {
  const length = uint32Column(fields.column("length", 4));
  const rows = length.length;
  const table: PageTable = {
    length,
    crc: uint32Column(fields.column("crc", 4, rows)),
    segments: uint32Column(fields.column("segments", 4, rows)),
    chunks: uint32Column(fields.column("chunks", 4, rows)),
    span: uint64Column(fields.column("span", 8, rows)),
    splats: uint32Column(fields.column("splats", 4, rows)),
    box: float32Column(fields.column("box", 24, rows)),
    contribution: float64Column(fields.column("contribution", 8, rows)),
    cell: fields.has("cell") ? uint32Column(fields.column("cell", 4, rows)) : new Uint32Array(rows),
  };
  fields.finish();
  if (rows > most) throw fields.outOfRange("length", `${rows} pages, at most ${most}`);
  checkRange(fields, "length", length, 1, MAX_PAGE_BYTES);
  checkRange(fields, "segments", table.segments, 1, MAX_SEGMENTS);
  const wrong = table.chunks.findIndex((chunks, row) => chunks > table.segments[row]!);
  if (wrong >= 0) throw fields.outOfRange("chunks", `page ${wrong} has more chunks than segments`);
  checkRange(fields, "span", table.span, 1, Number.MAX_SAFE_INTEGER);
  checkRange(fields, "splats", table.splats, 0, 2 ** 31 - 1);
  checkBoxes(fields, table.box);
  checkContribution(fields, table.contribution);
  return table;
}

function checkRange(fields: Fields, key: string, column: ArrayLike<number>, least: number, most: number): void {
  const row = Array.from(column).findIndex((value) => value < least || value > most);
  if (row >= 0) throw fields.outOfRange(key, `row ${row} has ${column[row]}, outside ${least} to ${most}`);
}

/** Refuse boxes that are not finite, or with a minimum above its maximum. */
function checkBoxes(fields: Fields, box: Float32Array): void {
  for (let i = 0; i < box.length; i += i % 6 === 2 ? 4 : 1) {
    const least = box[i]!;
    const most = box[i + 3]!;
    // NaN fails the comparison.
    if (!(least <= most && least > -Infinity && most < Infinity)) {
      throw fields.outOfRange("box", `row ${Math.floor(i / 6)} from ${least} to ${most}`);
    }
  }
}

function checkContribution(fields: Fields, contribution: Float64Array): void {
  const row = contribution.findIndex((value) => !(value >= 0 && value < Infinity));
  if (row >= 0) throw fields.outOfRange("contribution", `row ${row} has ${contribution[row]}`);
}

/** Numbers of a row in columns that have more than one. */
const ROW_WIDTHS: Readonly<Record<string, number>> = { hash: 16, box: 6 };

type Column = Uint8Array | Uint32Array | Float32Array | Float64Array;

/** A table whose rows become known index by index; rows between are zeros. */
export class GrowingTable<T extends SegmentTable | ChunkTable> {
  /** Rows up to the last one known: views of longer columns, so that most pages copy their own rows alone. */
  table: T;
  private columns: T;
  private count: number;
  private capacity: number;

  constructor(first: T, count: number) {
    this.table = this.columns = first;
    this.count = this.capacity = count;
  }

  /** Enter rows, the first of them as row `at`. */
  put(at: number, rows: T, count: number): void {
    this.count = Math.max(this.count, at + count);
    if (this.count > this.capacity) {
      this.capacity = Math.max(this.count, 2 * this.capacity);
      this.columns = this.map((column, width) => {
        const longer = new (column.constructor as new (length: number) => Column)(width * this.capacity);
        longer.set(column);
        return longer;
      });
    }
    for (const [key, column] of Object.entries(this.columns) as [keyof T & string, Column][]) {
      column.set(rows[key] as Column, (ROW_WIDTHS[key] ?? 1) * at);
    }
    this.table = this.map((column, width) => column.subarray(0, width * this.count));
  }

  private map(change: (column: Column, width: number) => Column): T {
    const columns = Object.entries(this.columns) as [string, Column][];
    return Object.fromEntries(
      columns.map(([key, column]) => [key, change(column, ROW_WIDTHS[key] ?? 1)]),
    ) as unknown as T;
  }
}

function bytesOf(view: DataView): Uint8Array {
  return new Uint8Array(view.buffer, view.byteOffset, view.byteLength);
}

/** Read a column of u32; bins are not aligned, so each number is read separately. */
export function uint32Column(view: DataView): Uint32Array {
  return Uint32Array.from({ length: view.byteLength / 4 }, (_, i) => view.getUint32(4 * i, true));
}

function float32Column(view: DataView): Float32Array {
  return Float32Array.from({ length: view.byteLength / 4 }, (_, i) => view.getFloat32(4 * i, true));
}

/** Read a column of u64; numbers of 2^53 and more become larger than any that is in range. */
function uint64Column(view: DataView): Float64Array {
  return Float64Array.from({ length: view.byteLength / 8 }, (_, i) => Number(view.getBigUint64(8 * i, true)));
}

/** Read a column of f64. */
export function float64Column(view: DataView): Float64Array {
  return Float64Array.from({ length: view.byteLength / 8 }, (_, i) => view.getFloat64(8 * i, true));
}
