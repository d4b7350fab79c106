import { CogsplatError } from "../errors.js";
import { crc32 } from "./crc32.js";
import { hex, PREAMBLE_BYTES } from "./preamble.js";
import type { ByteRange, SceneIndex, ScenePlaces } from "./scene_index.js";

/** Bytes of a row of a table of places: the object's name, its size, and where the segment begins in it (SPEC 3.4). */
const ROW_BYTES = 24;
const NAME_BYTES = 16;
const CRC_BYTES = 4;

/** Objects, of less than 2^32 bytes, lie so far apart that no request joins ranges of two. */
const SPACE = 2 ** 33;

/** An object of a folder. */
export interface FolderObject {
  /** Relative to the manifest. */
  readonly name: string;
  readonly size: number;
}

/**
 * Where the segments of a scene are in the objects of a folder (SPEC 3.4).
 *
 * All objects are in one space of addresses: the manifest begins at 0, and the first object at 2^33, the second at 2 · 2^33, and so on.
 */
export class FolderIndex implements ScenePlaces {
  /** The manifest, which has no name, and the objects that are known. */
  private readonly objects: FolderObject[] = [];
  private readonly numbers = new Map<string, number>();
  /** Address of each segment that is known. */
  private readonly addresses: number[] = [];
  /** First byte of the manifest behind what was read. */
  private end: number;
  /** Bytes of the manifest. */
  readonly manifestBytes: number;

  /**
   * @param index - Of the scene, its root alone.
   * @param manifest - Beginning of the manifest; the places of the root's segments are in its first 64 KiB.
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

  /** Compare the length of the manifest with what its root says. */
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
    // Before the page is read, so that one that came damaged can be asked for again.
    checkPlaces(places, `page ${number}`);
    this.index.addPage(bytes.slice(0, length));
    this.enter(places);
    this.end += bytes.length;
  }

  /** The object that an address is in, and where in it; the manifest has no name. */
  at(address: number): { readonly object: FolderObject; readonly offset: number } {
    const number = Math.floor(address / SPACE);
    return { object: this.objects[number]!, offset: address % SPACE };
  }

  /** Take the places of the segments behind those that have one. */
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
    // One that is stated with two sizes is refused with one of them.
    const key = `${name} ${size}`;
    const known = this.numbers.get(key);
    if (known !== undefined) return known;
    this.numbers.set(key, this.objects.length);
    return this.objects.push({ name, size }) - 1;
  }
}

/** Bytes that a table of places of so many segments takes. */
function placesBytes(segments: number): number {
  return ROW_BYTES * segments + CRC_BYTES;
}

function checkPlaces(places: Uint8Array, where: string): void {
  const end = places.length - CRC_BYTES;
  const stated = new DataView(places.buffer, places.byteOffset, places.byteLength).getUint32(end, true);
  if (crc32(places.subarray(0, end)) !== stated)
    throw new CogsplatError("places-crc", `the CRC of the places of ${where} does not match`);
}
