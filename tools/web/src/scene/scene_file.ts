import type { AttributeArray } from "../container/attributes.js";
import { type Camera, readCameras } from "../container/cameras.js";
import type { SetState } from "../container/chunk_sets.js";
import {
  checkPicture,
  type Description,
  PICTURE_NAMES,
  type PictureName,
  readDescription,
} from "../container/description.js";
import { ATTRIBUTE_TYPES, type SceneInfo } from "../container/root.js";
import { type Index, SceneIndex } from "../container/scene_index.js";
import { readViewTable, type ViewTable } from "../container/view_table.js";
import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { ChunkDecoder } from "./chunk_decoder.js";
import { shnFloats } from "./chunk_tail.js";
import { DEFAULT_RANGES, type PackedSplats } from "./packed_splats.js";
import { PrefixCompensation } from "./prefix_compensation.js";
import { concatenate, type Splats } from "./splats.js";

/** Options of `SceneFile`. */
export interface FileOptions {
  /** Accept a truncated file and decode the part present (SPEC 8.3). */
  readonly partial?: boolean;
  /** Decoded bytes at most (SPEC 9.2); by default 64 MiB and 256 for each byte of the source. */
  readonly maxDecodedBytes?: number;
}

/** Bytes of a decoded splat without shN: means, scales, quats, opacities, sh0. */
const HEAD_BYTES = 4 * (3 + 3 + 4 + 1 + 3);
/** Working memory per row of the largest chunk or codebook, bytes (SPEC 9.2). */
const WORKING_BYTES = 128;

/** A COGS file in memory, whole or truncated. */
export class SceneFile {
  readonly index: SceneIndex;
  private readonly decoder: ChunkDecoder;
  private readonly maxDecodedBytes: number;
  private layers: PrefixCompensation | undefined;

  /**
   * Open a file and check its whole index.
   *
   * @param bytes - The file, or with `partial` its first bytes.
   * @param kernels - Kernels of this file alone.
   */
  constructor(
    private readonly bytes: Uint8Array,
    private readonly k: Kernels,
    options: FileOptions = {},
  ) {
    this.index = SceneIndex.open(bytes, bytes.length, options.partial ?? false);
    for (let page = this.index.nextPage(); page !== undefined; page = this.index.nextPage()) {
      const { offset, length } = page;
      if (offset + length > bytes.length) break;
      this.index.addPage(page, bytes.slice(offset, offset + length));
    }
    this.decoder = new ChunkDecoder(k, this.index);
    this.maxDecodedBytes = options.maxDecodedBytes ?? defaultLimit(bytes.length);
  }

  /** Contents of the root about the scene. */
  get scene(): SceneInfo {
    return this.index.scene;
  }

  /** Number of chunks of the prefix present (SPEC 8.2). */
  get prefixChunks(): number {
    let chunk = 0;
    while (chunk < this.index.chunkCount && this.headIsThere(chunk)) chunk++;
    return chunk;
  }

  /** Return whether a chunk's coefficients above DC are present up to a degree. */
  hasTail(chunk: number, degree = this.scene.shDegree): boolean {
    const { tail } = this.index.chunkSegments(chunk);
    return tail >= 0 && this.isPresent(tail) && this.hasCodebooks(tail, degree);
  }

  /** Return whether a chunk's refinement is present. */
  hasRefinement(chunk: number): boolean {
    const { refinement } = this.index.chunkSegments(chunk);
    return refinement >= 0 && this.isPresent(refinement);
  }

  /**
   * Decode one chunk.
   *
   * @param degree - SH degree to decode; by default that of the scene.
   * @param refine - Whether to apply the chunk's refinement if present.
   * @param level - Level of the opacities (SPEC 5.11); by default the finest one present.
   */
  decodeChunk(chunk: number, degree = this.scene.shDegree, refine = true, level?: number): Splats {
    const { payloads, rows, needs } = this.prepare(chunk, degree, refine, level);
    return this.decoder.decode(payloads, rows, needs, degree);
  }

  /**
   * Decode one chunk to packed splats.
   *
   * @param ranges - Value ranges of the packed codes.
   */
  decodePacked(chunk: number, degree = this.scene.shDegree, ranges = DEFAULT_RANGES): PackedSplats {
    const { payloads, rows, needs } = this.prepare(chunk, degree, true);
    return this.decoder.decodePacked(payloads, rows, needs, degree, ranges);
  }

  /** Check that a chunk is present and small enough, decode its codebooks, and return its payloads. */
  private prepare(chunk: number, degree: number, refine: boolean, level?: number) {
    if (chunk >= this.prefixChunks) {
      throw new CogsplatError("file-truncated", `chunk ${chunk} is not in the ${this.bytes.length} bytes present`);
    }
    const { head, tail, refinement } = this.index.chunkSegments(chunk);
    const { needs } = this.index.segments;
    const rows = this.index.chunks.splats[chunk]!;
    const withTail = this.hasTail(chunk, degree) && degree > 0;
    this.checkSize(rows, degree);
    this.addCodebooks(chunk, degree);
    const opacities = this.opacitiesSegment(chunk, level);
    const payloads = {
      chunk,
      head: this.payload(head),
      refinement: refine && this.hasRefinement(chunk) ? this.payload(refinement) : undefined,
      opacities: opacities === undefined ? undefined : [this.payload(opacities)],
      tail: withTail ? this.payload(tail) : undefined,
    };
    return { payloads, rows, needs: { head: needs[head]!, tail: withTail ? needs[tail]! : 0 } };
  }

  /** Return the segment of a chunk's opacities at a level, or at the finest level present; undefined for the head's. */
  private opacitiesSegment(chunk: number, level: number | undefined): number | undefined {
    if (level !== undefined) return this.index.opacitiesAt(chunk, level);
    return this.index
      .chunkSegments(chunk)
      .opacities.filter((segment) => this.isPresent(segment))
      .at(-1);
  }

  /** Decode the codebooks that a chunk needs, unless they were decoded before. */
  private addCodebooks(chunk: number, degree: number): void {
    const { head, tail } = this.index.chunkSegments(chunk);
    const parts = this.hasTail(chunk, degree) && degree > 0 ? [head, tail] : [head];
    for (const part of parts) {
      // Heads use shape codebooks alone, whatever their needs state.
      for (const segment of this.index.codebookSegmentsOf(part, part === head ? 0 : degree)) this.addCodebook(segment);
    }
  }

  private addCodebook(segment: number): void {
    const { kind, owner } = this.index.segments;
    if (this.decoder.hasCodebook(owner[segment]!, kind[segment]!)) return;
    this.decoder.addCodebook(owner[segment]!, kind[segment]!, this.payload(segment));
  }

  /**
   * Decode all chunks that the prefix or a level draws, in file order.
   *
   * @param level - Level to decode, 0 the coarsest (SPEC 5.11); by default the finest one present.
   */
  decode(degree = this.scene.shDegree, refine = true, level?: number): Splats {
    const count = level === undefined ? this.prefixChunks : this.scene.levels[level]!.chunks;
    if (count > this.index.chunkCount) {
      throw new CogsplatError("file-truncated", `the page of chunk ${count - 1} is not in the bytes present`);
    }
    const drawn = Array.from({ length: count }, (_, chunk) => chunk).filter((chunk) =>
      this.index.isDrawn(chunk, count),
    );
    this.checkSize(
      drawn.reduce((sum, chunk) => sum + this.index.chunks.splats[chunk]!, 0),
      degree,
    );
    for (const chunk of drawn) this.addCodebooks(chunk, degree);
    return concatenate(
      drawn.map((chunk) => this.decodeChunk(chunk, degree, refine, level)),
      degree,
    );
  }

  /** Return a chunk's extra attributes; undefined where it has none, or they are missing. */
  attributes(chunk: number): Map<string, AttributeArray> | undefined {
    const segment = this.index.chunkSegments(chunk).attributes;
    if (segment < 0 || !this.isPresent(segment)) return undefined;
    const rows = this.index.chunks.splats[chunk]!;
    this.checkBytes(rows * (attributeBytes(this.scene) + WORKING_BYTES));
    return this.decoder.attributes(this.payload(segment), rows);
  }

  /** Return the cameras of the file; undefined where it has none. */
  cameras(): Camera[] | undefined {
    const [segment] = this.index.cameras;
    return segment === undefined || !this.isPresent(segment) ? undefined : readCameras(this.payload(segment));
  }

  /**
   * Return the description of the scene; undefined where it has none, or it is missing.
   *
   * @throws CogsplatError `description-segments` where the file has other pictures than the description says.
   */
  description(): Description | undefined {
    const { description: segment, pictures } = this.index;
    if (segment === undefined || !this.isPresent(segment)) return undefined;
    const description = readDescription(this.payload(segment));
    const differs = PICTURE_NAMES.find((name) => (description[name] === undefined) === pictures.has(name));
    if (differs !== undefined && this.index.complete) {
      throw new CogsplatError("description-segments", `the ${differs} is in the description or in the file alone`);
    }
    return description;
  }

  /** Return the file of a picture, whose header was checked; undefined where it is missing. */
  picture(name: PictureName): Uint8Array<ArrayBuffer> | undefined {
    const stated = this.description()?.[name];
    const segment = this.index.pictures.get(name);
    if (stated === undefined || segment === undefined || !this.isPresent(segment)) return undefined;
    const payload = this.payload(segment);
    checkPicture(stated, payload);
    return payload;
  }

  /**
   * Return the view table of an index; undefined where it has none, or it is missing.
   *
   * @param index - One of `SceneIndex.indexes`; by default the root.
   */
  viewTable(index: Index = this.index.indexes[0]!): ViewTable | undefined {
    const segment = this.index.viewTables.get(index);
    if (segment === undefined || !this.isPresent(segment)) return undefined;
    return readViewTable(this.k, this.payload(segment), index.contribution.length, this.maxDecodedBytes);
  }

  /**
   * Add compensation for missing chunks (SPEC 8.5) to the rows of one chunk, in place.
   *
   * @param splats - Decoded rows of the chunk.
   * @param prefix - Number of chunks of the prefix present; for a set of chunks what {@link setStates} says of this chunk.
   */
  compensate(splats: Splats, chunk: number, prefix: number | SetState): void {
    const { prefix: chunks, share } = typeof prefix === "number" ? { prefix, share: undefined } : prefix;
    const shifts = this.compensation.shifts(chunks, chunk, share);
    if (shifts === undefined) return;
    splats.scales.forEach((value, i) => {
      splats.scales[i] = value + shifts.scales[Math.floor(i / 3)]!;
    });
    splats.opacities.forEach((value, i) => {
      splats.opacities[i] = value + shifts.opacities[i]!;
    });
  }

  /**
   * Check a whole file: hashes, codebooks, cameras, compensation, view table, description, and all payloads of each chunk,
   * in the order of SPEC 8.10.
   *
   * @throws CogsplatError for the first fault.
   */
  async verify(): Promise<void> {
    const { segments, chunks, scene } = this.index;
    this.checkSize(
      chunks.splats.reduce((sum, n) => sum + n, 0),
      scene.shDegree,
      attributeBytes(scene),
    );
    for (let segment = 0; segment < segments.kind.length; segment++) {
      const payload = this.payload(segment);
      const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", payload));
      const hash = segments.hash.subarray(16 * segment, 16 * segment + 16);
      if (hash.some((byte, i) => byte !== digest[i])) {
        throw new CogsplatError(
          "segment-hash",
          `the hash of segment ${segment} does not match`,
          this.index.segments.offset[segment],
        );
      }
    }
    // Codebooks that no chunk uses are checked too.
    for (const segment of this.index.allCodebookSegments()) this.addCodebook(segment);
    this.cameras();
    this.readLayers();
    for (const index of this.index.indexes) this.viewTable(index);
    for (const name of PICTURE_NAMES) this.picture(name);
    for (let chunk = 0; chunk < this.index.chunkCount; chunk++) {
      this.checkBox(this.decodeChunk(chunk, 0, false), chunk);
      if (this.hasRefinement(chunk)) this.checkBox(this.decodeChunk(chunk, 0), chunk);
      for (let level = 0; level < scene.levels.length; level++) {
        if (this.index.opacitiesAt(chunk, level) !== undefined) this.decodeChunk(chunk, 0, true, level);
      }
      this.decodeChunk(chunk);
      this.attributes(chunk);
    }
  }

  private checkBox(splats: Splats, chunk: number): void {
    const box = this.index.chunks.box.subarray(6 * chunk, 6 * chunk + 6);
    const outside = splats.means.findIndex((value, i) => !(box[i % 3]! <= value && value <= box[3 + (i % 3)]!));
    if (outside >= 0) {
      throw new CogsplatError(
        "chunk-box",
        `mean ${Math.floor(outside / 3)} of chunk ${chunk} is outside the chunk's box`,
      );
    }
  }

  /** Layers of compensation that are present. */
  get compensation(): PrefixCompensation {
    this.layers ??= this.readLayers();
    return this.layers;
  }

  private readLayers(): PrefixCompensation {
    const layers = new PrefixCompensation(this.index);
    this.index.compensation.forEach((segment, layer) => {
      if (this.isPresent(segment)) layers.add(layer, this.payload(segment));
    });
    return layers;
  }

  private headIsThere(chunk: number): boolean {
    const { head } = this.index.chunkSegments(chunk);
    return this.isPresent(head) && this.hasCodebooks(head, 0);
  }

  /** Return whether the codebooks that a segment needs are present, colours up to a degree. */
  private hasCodebooks(segment: number, degree: number): boolean {
    return this.index.codebookSegmentsOf(segment, degree).every((book) => this.isPresent(book));
  }

  private isPresent(segment: number): boolean {
    const { offset, length } = this.index.range(segment);
    return offset + length <= this.bytes.length;
  }

  private payload(segment: number): Uint8Array<ArrayBuffer> {
    const { offset, length } = this.index.range(segment);
    if (offset + length > this.bytes.length) {
      throw new CogsplatError("file-truncated", `segment ${segment} is not in the ${this.bytes.length} bytes present`);
    }
    const payload = new Uint8Array(this.bytes.subarray(offset, offset + length));
    this.index.checkCrc(segment, payload);
    return payload;
  }

  /** Refuse a decode that takes more memory than the caller allows (SPEC 9.2). */
  private checkSize(rows: number, degree: number, extraBytes = 0): void {
    const books = this.index.codebooks;
    const codebooks = books.reduce((sum, { rows: count, attribute }) => {
      return sum + count * 4 * (attribute === "shape" ? 7 : shnFloats(degree));
    }, 0);
    const largest = books.reduce(
      (most, book) => Math.max(most, book.rows),
      this.index.chunks.splats.reduce((most, n) => Math.max(most, n), 0),
    );
    this.checkBytes(rows * (HEAD_BYTES + 4 * shnFloats(degree) + extraBytes) + codebooks + largest * WORKING_BYTES);
  }

  private checkBytes(bytes: number): void {
    if (bytes > this.maxDecodedBytes) {
      throw new CogsplatError("decoded-size", `${bytes} decoded bytes, at most ${this.maxDecodedBytes}`);
    }
  }
}

/** Return the limit of decoded bytes of SPEC 9.2: 64 MiB and 256 bytes for each byte of the source. */
export function defaultLimit(sourceBytes: number): number {
  return 64 * 2 ** 20 + 256 * sourceBytes;
}

/** Return the bytes of a splat's extra attributes. */
function attributeBytes(scene: SceneInfo): number {
  return scene.attributes.reduce((sum, entry) => sum + Math.max(entry.components, 1) * ATTRIBUTE_TYPES[entry.type], 0);
}
