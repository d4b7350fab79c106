import { CogsplatError } from "../errors.js";
import { crc32 } from "./crc32.js";
import { hex, PREAMBLE_BYTES } from "./preamble.js";
import type { ByteRange, SceneIndex, ScenePlaces } from "./scene_index.js";

/** Bytes of a row of a table of places: name and size of the object, offset of the segment in it (SPEC 3.4). */
const ROW_BYTES = 24;
const NAME_BYTES = 16;
const CRC_BYTES = 4;

/** Distance of two objects in the address space; objects are shorter than 2^32 bytes, so no request spans two. */
const SPACE = 2 ** 33;

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
  /** Address of each segment whose table of places was read. */
  private readonly addresses: number[] = [];
  /** Offset of the next index page in the manifest. */
  private end: number;
  /** Bytes of the manifest. */
  readonly manifestBytes: number;

  /**
   * @param index - Index of the scene, with its root alone.
   * @param manifest - First bytes of the manifest; the places of the root's segments are in its first 64 KiB.
   */
  constructor(
    private readonly index: SceneIndex,
    manifest: Uint8Array,
  ) {
    const rootEnd = PREAMBLE_BYTES + index.rootLength;
    this.end = rootEnd + placesBytes(index.segments.kind.length);
    this.manifestBytes = index.pages.reduce((sum, page) => sum + page.length + placesBytes(page.segments), this.end);
    if (manifest.length < this.end) {
      throw new CogsplatError(
        "file-truncated",
        `${manifest.length} bytes of a manifest of ${this.manifestBytes}`,
        manifest.length,
      );
    }
    this.objects.push({ name: "", size: this.manifestBytes });
    const places = manifest.subarray(rootEnd, this.end);
    checkPlaces(places, "the root");
    this.enter(places);
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
    return { offset: this.addresses[segment]!, length: this.index.segments.length[segment]! };
  }

  nextPage(): ByteRange | undefined {
    const page = this.index.nextPage();
    const entry = this.index.pages[this.index.pagesRead];
    return page && entry && { offset: this.end, length: page.length + placesBytes(entry.segments) };
  }

  addPage(bytes: Uint8Array): void {
    const number = this.index.pagesRead;
    const { length } = this.index.pages[number]!;
    const places = bytes.subarray(length);
    // The places are checked before the page is entered, so that a damaged page can be fetched again.
    checkPlaces(places, `page ${number}`);
    this.index.addPage(bytes.slice(0, length));
    this.enter(places);
    this.end += bytes.length;
  }

  /** Return the object at an address and the offset in it. */
  at(address: number): { readonly object: FolderObject; readonly offset: number } {
    const number = Math.floor(address / SPACE);
    return { object: this.objects[number]!, offset: address % SPACE };
  }

  /** Enter the addresses of the segments of a page. */
  private enter(places: Uint8Array): void {
    const first = this.addresses.length;
    const count = this.index.segments.kind.length - first;
    const view = new DataView(places.buffer, places.byteOffset, places.byteLength);
    for (let row = 0; row < count; row++) {
      const digits = hex(places.subarray(NAME_BYTES * row, NAME_BYTES * (row + 1)));
      const size = view.getUint32(NAME_BYTES * count + 4 * row, true);
      const offset = view.getUint32((NAME_BYTES + 4) * count + 4 * row, true);
      const end = offset + this.index.segments.length[first + row]!;
      if (end > size)
        throw new CogsplatError("places-range", `segment ${first + row} ends at byte ${end} of an object of ${size}`);
      this.addresses.push(this.numberOf(`segments/${digits}.bin`, size) * SPACE + offset);
    }
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
function placesBytes(segments: number): number {
  return ROW_BYTES * segments + CRC_BYTES;
}

function checkPlaces(places: Uint8Array, where: string): void {
  const end = places.length - CRC_BYTES;
  const stated = new DataView(places.buffer, places.byteOffset, places.byteLength).getUint32(end, true);
  if (crc32(places.subarray(0, end)) !== stated)
    throw new CogsplatError("places-crc", `the CRC of the places of ${where} does not match`);
}
