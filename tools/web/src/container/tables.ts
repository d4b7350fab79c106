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
  for (let i = 0; i < rows; i++) {
    if (splats[i]! < 1 || splats[i]! > MAX_CHUNK_SPLATS)
      throw fields.outOfRange("splats", `chunk ${i} has ${splats[i]}`);
    for (let axis = 0; axis < 3; axis++) {
      const least = box[6 * i + axis]!;
      const most = box[6 * i + 3 + axis]!;
      // Both ends must be finite, with the minimum at most the maximum; NaN fails the comparison.
      if (!(least <= most && least > -Infinity && most < Infinity)) {
        throw fields.outOfRange("box", `chunk ${i} from ${least} to ${most}`);
      }
    }
    const contributed = contribution[i]!;
    if (!(contributed >= 0 && contributed < Infinity)) {
      throw fields.outOfRange("contribution", `chunk ${i} has ${contributed}`);
    }
    const quality = table.quality[i]!;
    if (!(quality >= 0 && quality <= 100)) throw fields.outOfRange("quality", `chunk ${i} has ${quality} dB`);
  }
  return table;
}

/** Append the rows of a second table. */
export function joinTables<T extends SegmentTable | ChunkTable>(first: T, second: T): T {
  const columns = Object.entries(first) as [keyof T, Column][];
  return Object.fromEntries(columns.map(([key, column]) => [key, join(column, second[key] as Column)])) as unknown as T;
}

type Column = Uint8Array | Uint32Array | Float32Array | Float64Array;

function join<T extends Column>(first: T, second: T): T {
  const joined = new (first.constructor as new (length: number) => T)(first.length + second.length);
  joined.set(first);
  joined.set(second, first.length);
  return joined;
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

/** Read a column of f64. */
export function float64Column(view: DataView): Float64Array {
  return Float64Array.from({ length: view.byteLength / 8 }, (_, i) => view.getFloat64(8 * i, true));
}
