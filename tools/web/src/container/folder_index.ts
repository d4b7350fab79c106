import { CogsplatError } from "../errors.js";
import { crc32 } from "./crc32.js";
import { hex, PREAMBLE_BYTES } from "./preamble.js";
import type { ByteRange, Index, Page, SceneIndex, ScenePlaces } from "./scene_index.js";

/** Bytes of a row of a table of places: name and size of the object, offset of the segment or page in it (SPEC 3.4). */
const ROW_BYTES = 24;
const NAME_BYTES = 16;
const CRC_BYTES = 4;

/** Bytes of a manifest at most (SPEC 3.4). */
const MAX_MANIFEST_BYTES = 65_536;

/** Distance of two objects in the address space; objects are shorter than 2^32 bytes, so no request spans two. */
const SPACE = 2 ** 33;

/** A row of a table of places; all of it is 0 for a segment in the manifest. */
interface Place {
  /** First 16 bytes of the object's SHA-256, as hexadecimal digits. */
  readonly digits: string;
  readonly size: number;
  readonly offset: number;
}

/** An object of a folder. */
export interface FolderObject {
  /** Path relative to the manifest. */
  readonly name: string;
  readonly size: number;
}

/**
 * Addresses of a scene's segments in the objects of a folder (SPEC 3.4).
 *
 * All objects share one address space: the manifest is at 0, the first object at 2^33, the second at 2 · 2^33, and so
 * on.
 */
export class FolderIndex implements ScenePlaces {
  /** The manifest, whose name is empty, then the objects in the order of their first segment. */
  private readonly objects: FolderObject[] = [];
  private readonly numbers = new Map<string, number>();
  /** Address of each segment and of each page whose row was read, and the bytes of the page's object from there on. */
  private readonly addresses = new Map<number, number>();
  private readonly pageAddresses = new Map<Page, ByteRange>();
  /** Bytes of the manifest. */
  readonly manifestBytes: number;

  /**
   * @param index - Index of the scene, with its root alone.
   * @param manifest - The whole manifest; further bytes are ignored.
   */
  constructor(
    private readonly index: SceneIndex,
    manifest: Uint8Array,
  ) {
    const rootEnd = PREAMBLE_BYTES + index.rootLength;
    const { length } = index.segments;
    const placesEnd = rootEnd + placesBytes(length.length + index.pages.length);
    const requireBytes = (end: number): void => {
      if (manifest.length < end)
        throw new CogsplatError("file-truncated", `${manifest.length} bytes of a manifest of ${end}`, manifest.length);
    };
    requireBytes(placesEnd);
    const places = readPlaces(manifest.subarray(rootEnd, placesEnd), "the root");
    const isInside = places.map((place, row) => row < length.length && isZero(place));
    this.manifestBytes = length.reduce((sum, bytes, row) => sum + (isInside[row] ? bytes : 0), placesEnd);
    if (this.manifestBytes > MAX_MANIFEST_BYTES)
      throw new CogsplatError("places-range", `a manifest of ${this.manifestBytes} bytes`, placesEnd);
    requireBytes(this.manifestBytes);
    this.objects.push({ name: "", size: this.manifestBytes });
    let end = placesEnd;
    const pages = index.pages.map((page) => page.length);
    const ranges = this.rangesOf(places, length, pages, "the root", (row, bytes) => {
      if (!isInside[row]) return undefined;
      end += bytes;
      return { offset: end - bytes, length: bytes };
    });
    this.enter(ranges, index.indexes[0]!);
  }

  /** Compare the length of the manifest with the length that its root implies. */
  checkLength(length: number): void {
    const code = length < this.manifestBytes ? "file-truncated" : "file-trailing";
    if (length !== this.manifestBytes) {
      throw new CogsplatError(
        code,
        `a manifest of ${length} bytes, expected ${this.manifestBytes}`,
        Math.min(length, this.manifestBytes),
      );
    }
  }

  range(segment: number): ByteRange {
    return { offset: this.addresses.get(segment)!, length: this.index.segments.length[segment]! };
  }

  /**
   * Return the range of a page and its places, or a longer one: the rows of the places are known from the page alone, where
   * each has more bytes.
   */
  pageRange(page: Page): ByteRange {
    const { offset, length } = this.pageAddresses.get(page)!;
    return { offset, length: Math.min(length, 2 * page.length + CRC_BYTES) };
  }

  addPage(page: Page, bytes: Uint8Array): void {
    if (this.index.isRead(page)) return;
    const { length } = page;
    const where = `page ${page.number}`;
    const tables = this.index.readPage(page, bytes.slice(0, length));
    const end = length + placesBytes(tables.segments.kind.length + (tables.pages?.length.length ?? 0));
    if (bytes.length < end)
      throw new CogsplatError("places-range", `${where} with its places of ${end} bytes in ${bytes.length}`);
    // The places are checked before the page is entered, so that a damaged page can be fetched again.
    const places = readPlaces(bytes.subarray(length, end), where);
    const ranges = this.rangesOf(places, tables.segments.length, tables.pages?.length ?? [], where);
    this.enter(ranges, this.index.enterPage(page, tables));
  }

  /** Return for each segment and page of an index its address, and the bytes of its object from there on. */
  private rangesOf(
    places: readonly Place[],
    segments: ArrayLike<number>,
    pages: ArrayLike<number>,
    where: string,
    inside: (row: number, bytes: number) => ByteRange | undefined = () => undefined,
  ): ByteRange[] {
    return places.map((place, row) => {
      const bytes = segments[row] ?? pages[row - segments.length]!;
      const found = inside(row, bytes);
      if (found !== undefined) return found;
      const offset = this.addressOf(place, bytes, `row ${row} of the places of ${where}`);
      return { offset, length: place.size - place.offset };
    });
  }

  /** Enter the ranges of an index. */
  private enter(ranges: readonly ByteRange[], index: Index): void {
    for (const [row, range] of ranges.entries()) {
      const page = index.pages[row - index.segmentCount];
      if (page === undefined) this.addresses.set(index.firstSegment + row, range.offset);
      else this.pageAddresses.set(page, range);
    }
  }

  /** Return the object at an address and the offset in it. */
  at(address: number): { readonly object: FolderObject; readonly offset: number } {
    const number = Math.floor(address / SPACE);
    return { object: this.objects[number]!, offset: address % SPACE };
  }

  /** Return the address of a segment or page of a length, bytes. */
  private addressOf({ digits, size, offset }: Place, length: number, what: string): number {
    const end = offset + length;
    if (end > size) throw new CogsplatError("places-range", `${what} ends at byte ${end} of an object of ${size}`);
    return this.numberOf(`segments/${digits}.bin`, size) * SPACE + offset;
  }

  private numberOf(name: string, size: number): number {
    // An object stated with two sizes becomes two entries; fetching one of them fails.
    const key = `${name} ${size}`;
    const known = this.numbers.get(key);
    if (known !== undefined) return known;
    this.numbers.set(key, this.objects.length);
    return this.objects.push({ name, size }) - 1;
  }
}

/** Return the length of a table of places, bytes. */
function placesBytes(rows: number): number {
  return ROW_BYTES * rows + CRC_BYTES;
}

/** Read the rows of a table of places, after its CRC was checked. */
function readPlaces(bytes: Uint8Array, where: string): Place[] {
  const end = bytes.length - CRC_BYTES;
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (crc32(bytes.subarray(0, end)) !== view.getUint32(end, true))
    throw new CogsplatError("places-crc", `the CRC of the places of ${where} does not match`);
  const count = end / ROW_BYTES;
  return Array.from({ length: count }, (_, row) => ({
    digits: hex(bytes.subarray(NAME_BYTES * row, NAME_BYTES * (row + 1))),
    size: view.getUint32(NAME_BYTES * count + 4 * row, true),
    offset: view.getUint32((NAME_BYTES + 4) * count + 4 * row, true),
  }));
}

function isZero({ digits, size, offset }: Place): boolean {
  return size === 0 && offset === 0 && /^0+$/.test(digits);
}
