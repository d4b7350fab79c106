import { crc32 } from "../src/container/crc32.js";
import { parseMap, type ValueMap } from "../src/container/msgpack.js";
import { encode, join, u32, withRoot } from "./padded_file.js";

/** Chunks that an index lists itself, and its pages. */
export interface Shape {
  readonly chunks: number;
  readonly pages?: readonly Shape[];
}

/** Kinds of segments of chunks, and of view tables, whose columns depend on the tree. */
const OF_CHUNKS = [1, 2, 7, 8, 129];
const VIEW_TABLE = 131;

type Columns = Record<string, Uint8Array>;

interface Placed {
  readonly payload: Uint8Array;
  readonly row: Columns;
}

/** An index with all that is below it. */
interface Laid {
  readonly map: ValueMap;
  /** Everything behind the index. */
  readonly rest: Uint8Array;
  readonly segments: number;
  readonly chunks: readonly number[];
}

/** A shape all of whose chunks are listed by pages, `depth` deep, each of which lists one chunk and one page. */
export function chain(chunks: number, depth: number): Shape {
  return depth === 0 || chunks < 2 ? { chunks } : { chunks: 1, pages: [chain(chunks - 1, depth - 1)] };
}

/**
 * A file whose index is a tree, with the chunks of another in the same order.
 *
 * @param file - A file without pages; its view table is left out.
 * @param padding - Bytes that are appended to each page as a segment that is skipped.
 * @param newBoxes - Boxes of all chunks, in place of those of the file.
 */
export function treeFile(file: Uint8Array, shape: Shape, padding = 0, newBoxes?: readonly number[]): Uint8Array {
  const view = new DataView(file.buffer, file.byteOffset);
  const rootEnd = 64 + view.getUint32(12, true);
  const root = parseMap(file.slice(64, rootEnd));
  const segmentMap = root.get("segments") as ValueMap;
  const chunkMap = root.get("chunks") as ValueMap;
  const lengths = columnOf(segmentMap, "length");
  const kinds = segmentMap.get("kind") as Uint8Array;
  const owners = columnOf(segmentMap, "owner");
  let offset = rootEnd;
  const ofRoot: Placed[] = [];
  const ofChunks = new Map<number, Placed[]>();
  for (const [segment, kind] of kinds.entries()) {
    const payload = file.slice(offset, offset + lengths[segment]!);
    offset += payload.length;
    const placed = { payload, row: rowOf(segmentMap, segment, kinds.length) };
    const chunk = owners[segment]!;
    if (OF_CHUNKS.includes(kind)) ofChunks.set(chunk, [...(ofChunks.get(chunk) ?? []), placed]);
    else if (kind !== VIEW_TABLE) ofRoot.push(placed);
  }
  if (newBoxes !== undefined) chunkMap.set("box", new Uint8Array(Float32Array.from(newBoxes).buffer));
  const counts = columnOf(chunkMap, "splats");
  const cells = chunkMap.has("cell") ? columnOf(chunkMap, "cell") : counts.map(() => 0);
  const boxes = floatsOf(chunkMap, "box", 4);
  const contributions = floatsOf(chunkMap, "contribution", 8);
  let next = 0;
  const lay = ({ chunks, pages = [] }: Shape, own: readonly Placed[], isPage: boolean): Laid => {
    const numbers = Array.from({ length: chunks }, () => next++);
    const segments = [...own, ...numbers.flatMap((chunk) => ofChunks.get(chunk)!)];
    if (isPage && padding > 0) segments.push(paddingOf(padding));
    const below = pages.map((page) => lay(page, [], true));
    const map: ValueMap = new Map();
    if (below.length > 0) map.set("pages", pagesOf(below));
    map.set(
      "segments",
      joinRows(
        [...segmentMap.keys()],
        segments.map(({ row }) => row),
      ),
    );
    map.set(
      "chunks",
      joinRows(
        [...chunkMap.keys()],
        numbers.map((chunk) => rowOf(chunkMap, chunk, counts.length)),
      ),
    );
    return {
      map,
      rest: join(...segments.map(({ payload }) => payload), ...below.flatMap((page) => [encode(page.map), page.rest])),
      segments: segments.length + below.reduce((sum, page) => sum + page.segments, 0),
      chunks: [...numbers, ...below.flatMap((page) => page.chunks)],
    };
  };
  const pagesOf = (below: readonly Laid[]): ValueMap => {
    const u64 = (value: number): Uint8Array => new Uint8Array(BigUint64Array.of(BigInt(value)).buffer);
    const rows = below.map(({ map, rest, segments, chunks }): Columns => {
      const bytes = encode(map);
      const box = [0, 1, 2, 3, 4, 5].map((axis) =>
        chunks.map((chunk) => boxes[6 * chunk + axis]!).reduce((a, b) => (axis < 3 ? Math.min(a, b) : Math.max(a, b))),
      );
      const contribution = chunks.reduce((sum, chunk) => sum + contributions[chunk]!, 0);
      return {
        length: u32(bytes.length),
        crc: u32(crc32(bytes)),
        segments: u32(segments),
        chunks: u32(chunks.length),
        span: u64(rest.length),
        splats: u32(chunks.reduce((sum, chunk) => sum + counts[chunk]!, 0)),
        box: new Uint8Array(Float32Array.from(box).buffer),
        contribution: new Uint8Array(Float64Array.of(contribution).buffer),
        cell: u32(chunks.map((chunk) => cells[chunk]!).reduce(around)),
      };
    });
    return joinRows(Object.keys(rows[0]!), rows);
  };
  const laid = lay(shape, ofRoot, false);
  return withRoot(file, new Map([...root, ...laid.map]), laid.rest);
}

/** The smallest cell that contains two. */
function around(first: number, second: number): number {
  let [a, b] = [first, second];
  while (a !== b) [a, b] = a > b ? [a >>> 1, b] : [a, b >>> 1];
  return a;
}

function paddingOf(bytes: number): Placed {
  const payload = Uint8Array.from({ length: bytes }, (_, i) => (i * 31) & 255);
  return {
    payload,
    row: {
      kind: Uint8Array.of(200),
      owner: u32(0),
      length: u32(bytes),
      crc: u32(crc32(payload)),
      hash: new Uint8Array(16),
      needs: u32(0),
    },
  };
}

function rowOf(map: ValueMap, row: number, rows: number): Columns {
  return Object.fromEntries(
    [...map].map(([key, value]) => {
      const column = value as Uint8Array;
      const width = column.length / rows;
      return [key, column.slice(width * row, width * (row + 1))];
    }),
  );
}

function joinRows(keys: readonly string[], rows: readonly Columns[]): ValueMap {
  return new Map(keys.map((key) => [key, join(...rows.map((row) => row[key]!))]));
}

function columnOf(map: ValueMap, key: string): number[] {
  const column = map.get(key) as Uint8Array;
  const view = new DataView(column.buffer, column.byteOffset, column.byteLength);
  return Array.from({ length: column.length / 4 }, (_, i) => view.getUint32(4 * i, true));
}

function floatsOf(map: ValueMap, key: string, bytes: 4 | 8): number[] {
  const column = map.get(key) as Uint8Array;
  const view = new DataView(column.buffer, column.byteOffset, column.byteLength);
  const at = (i: number): number => (bytes === 4 ? view.getFloat32(4 * i, true) : view.getFloat64(8 * i, true));
  return Array.from({ length: column.length / bytes }, (_, i) => at(i));
}
