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
export const MAX_SEGMENTS = 2_097_152;

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

type Column = Uint8Array | Uint32Array | Float32Array | Float64Array | BigUint64Array;
type ColumnType = new (numbers: number | ArrayBuffer) => Column;

/** Numbers of a row in columns that have more than one. */
const ROW_WIDTHS: Readonly<Record<string, number>> = { hash: 16, box: 6 };

/**
 * Read the columns of a table.
 *
 * @param needed - Columns in their order; the first sets the number of rows.
 * @param optional - Columns that are zeros where they are absent.
 */
function readColumns(
  fields: Fields,
  needed: Readonly<Record<string, ColumnType>>,
  optional: Readonly<Record<string, ColumnType>> = {},
): Record<string, Column> {
  const table: Record<string, Column> = {};
  let rows: number | undefined;
  for (const [key, Type] of Object.entries({ ...needed, ...optional })) {
    const width = ROW_WIDTHS[key] ?? 1;
    if (Object.hasOwn(optional, key) && !fields.has(key)) {
      table[key] = new Type(width * rows!);
      continue;
    }
    const bytes = fields.column(key, width * new Type(0).BYTES_PER_ELEMENT, rows);
    // Bins are not aligned; columns and memory are little-endian.
    const column = new Type(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength) as ArrayBuffer);
    table[key] = column;
    rows ??= column.length / width;
  }
  fields.finish();
  return table;
}

/** Read the field `segments` of a root or a page. */
export function readSegmentTable(fields: Fields): SegmentTable {
  const table = readColumns(fields, {
    kind: Uint8Array,
    owner: Uint32Array,
    length: Uint32Array,
    crc: Uint32Array,
    hash: Uint8Array,
    needs: Uint32Array,
  }) as unknown as SegmentTable;
  const known = new Set<number>(Object.values(SegmentKind));
  const unknown = table.kind.findIndex((value) => value < FIRST_SKIPPABLE_KIND && !known.has(value));
  if (unknown >= 0) {
    const found = `${fields.where}: segment ${unknown} is of kind ${table.kind[unknown]}`;
    throw new CogsplatError("segment-kind-unknown", found);
  }
  checkRange(fields, "length", table.length, 1);
  return table;
}

/** Read the field `chunks` of a root or a page. */
export function readChunkTable(fields: Fields): ChunkTable {
  const table = readColumns(
    fields,
    { splats: Uint32Array, box: Float32Array, contribution: Float64Array },
    { layer: Uint32Array, cell: Uint32Array, object: Uint32Array, quality: Float32Array, until: Uint32Array },
  ) as unknown as ChunkTable;
  checkRange(fields, "splats", table.splats, 1, MAX_CHUNK_SPLATS);
  checkBoxes(fields, table);
  checkRange(fields, "quality", table.quality, 0, 100);
  return table;
}

/**
 * Read the field `pages` of a root or a page.
 *
 * @param most - Number of rows at most.
 */
export function readPageTable(fields: Fields, most: number): PageTable {
  const columns = readColumns(
    fields,
    {
      length: Uint32Array,
      crc: Uint32Array,
      segments: Uint32Array,
      chunks: Uint32Array,
      span: BigUint64Array,
      splats: Uint32Array,
      box: Float32Array,
      contribution: Float64Array,
    },
    { cell: Uint32Array },
  );
  // Numbers of 2^53 and more stay out of range.
  const table = { ...columns, span: Float64Array.from(columns["span"]!, Number) } as unknown as PageTable;
  const { length, segments, chunks } = table;
  if (length.length > most) throw fields.outOfRange("length", `${length.length} pages, at most ${most}`);
  checkRange(fields, "length", length, 1, MAX_PAGE_BYTES);
  checkRange(fields, "segments", segments, 1, MAX_SEGMENTS);
  const wrong = chunks.findIndex((count, row) => count > segments[row]!);
  if (wrong >= 0) throw fields.outOfRange("chunks", `row ${wrong} has more chunks than segments`);
  checkRange(fields, "span", table.span, 1, Number.MAX_SAFE_INTEGER);
  checkRange(fields, "splats", table.splats, 0, 2 ** 31 - 1);
  checkBoxes(fields, table);
  return table;
}

/** Refuse a number outside a range, or that is none. */
function checkRange(
  fields: Fields,
  key: string,
  column: Uint32Array | Float32Array | Float64Array,
  least: number,
  most = Number.MAX_VALUE,
): void {
  for (const [row, value] of column.entries()) {
    if (!(value >= least && value <= most)) throw fields.outOfRange(key, `row ${row} has ${value}`);
  }
}

/** Refuse boxes that are not finite, or with a minimum above its maximum, and contributions below 0. */
function checkBoxes(fields: Fields, { box, contribution }: Pick<ChunkTable, "box" | "contribution">): void {
  checkRange(fields, "box", box, -Number.MAX_VALUE);
  for (const [i, least] of box.entries()) {
    if (i % 6 < 3 && least > box[i + 3]!) throw fields.outOfRange("box", `row ${Math.floor(i / 6)} is turned`);
  }
  checkRange(fields, "contribution", contribution, 0);
}

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
        longer.set(column as never);
        return longer;
      });
    }
    for (const [key, column] of Object.entries(this.columns) as [keyof T & string, Column][]) {
      column.set(rows[key] as never, (ROW_WIDTHS[key] ?? 1) * at);
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

/** Read a column of f64; bins are not aligned, so each number is read separately. */
export function float64Column(view: DataView): Float64Array {
  return Float64Array.from({ length: view.byteLength / 8 }, (_, i) => view.getFloat64(8 * i, true));
}
