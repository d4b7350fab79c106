import { CogsplatError } from "../errors.js";
import { crc32 } from "./crc32.js";
import { PICTURE_NAMES, type PictureName } from "./description.js";
import { Fields } from "./fields.js";
import { parseMap } from "./msgpack.js";
import { PREAMBLE_BYTES, readPreamble } from "./preamble.js";
import { type CodebookEntry, type PageEntry, readRoot, type SceneInfo } from "./root.js";
import {
  type ChunkTable,
  joinTables,
  readChunkTable,
  readSegmentTable,
  SegmentKind,
  type SegmentTable,
} from "./tables.js";

/** Segments of a file at most (SPEC 9.1). */
const MAX_SEGMENTS = 1_048_576;
/** Segments of later opacities of a chunk that no later level changes. */
const NO_OPACITIES: readonly number[] = [];
/** Bytes of a description, and of a picture, at most (SPEC 9.1). */
const MAX_DESCRIPTION = 1_048_576;
const MAX_PICTURE = 16_777_216;
/** Segment number of a kind that a chunk does not have. */
const NONE = -1;

/** A byte range of a file or of an address space. */
export interface ByteRange {
  readonly offset: number;
  readonly length: number;
}

/** Byte ranges of a scene's segments and index pages, in a file or in the objects of a folder. */
export interface ScenePlaces {
  /** Return the byte range of a segment. */
  range(segment: number): ByteRange;
  /** Return the byte range of the next unread page; undefined where all are read. */
  nextPage(): ByteRange | undefined;
  /** Read the page of `nextPage`. */
  addPage(bytes: Uint8Array): void;
}

/** Segment numbers of one chunk; −1 for a kind that it does not have, or whose page was not read. */
export interface ChunkSegments {
  readonly head: number;
  readonly refinement: number;
  readonly tail: number;
  readonly attributes: number;
  /** Segments of opacities at later levels, in the order of the levels. */
  readonly opacities: readonly number[];
}

/**
 * The index of a file: the root and the pages read so far (SPEC 3 to 5).
 *
 * Files are refused in the order of SPEC 8.1: `open` and `addPage` check each table by itself, and `crossCheck` checks them
 * together. `crossCheck` makes the chunks of new pages available.
 */
export class SceneIndex {
  readonly scene: SceneInfo;
  readonly codebooks: readonly CodebookEntry[];
  readonly fileLength: number;
  readonly rootLength: number;
  readonly pages: readonly PageEntry[];
  segments: SegmentTable;
  chunks: ChunkTable;
  /** Byte offset of each segment in the file. */
  offsets = new Float64Array(0);
  /** Number of pages read. */
  pagesRead = 0;
  /** Segments of compensation, cameras and view tables, in file order. */
  readonly compensation: number[] = [];
  readonly cameras: number[] = [];
  readonly viewTables: number[] = [];
  /** Segment of the description; undefined where there is none. */
  description: number | undefined;
  /** Segments of the pictures, by name. */
  readonly pictures = new Map<PictureName, number>();

  private readonly totalChunks: number;
  /** Number of segments that the root lists. */
  private readonly rootSegments: number;
  private readonly heads: number[] = [];
  private readonly tails: Int32Array;
  private readonly refinements: Int32Array;
  private readonly attributes: Int32Array;
  private readonly opacities = new Map<number, number[]>();
  /** Segment of each kind, for each codebook. */
  private readonly codebookSegments: Map<number, number>[];
  /** End of the segments read so far, bytes. */
  private end: number;
  /** Number of segments that `crossCheck` has entered. */
  private settled = 0;

  private constructor(bytes: Uint8Array) {
    const preamble = readPreamble(bytes);
    const rootEnd = PREAMBLE_BYTES + preamble.rootLength;
    if (bytes.length < rootEnd) {
      const found = `${bytes.length} of ${preamble.fileLength} bytes, the root ends at ${rootEnd}`;
      throw new CogsplatError("root-truncated", found, PREAMBLE_BYTES);
    }
    const rootBytes = bytes.slice(PREAMBLE_BYTES, rootEnd);
    if (crc32(rootBytes) !== preamble.rootCrc) {
      throw new CogsplatError("root-crc", "the root's CRC does not match", PREAMBLE_BYTES);
    }
    const root = readRoot(rootBytes);
    this.scene = root.scene;
    this.codebooks = root.codebooks;
    this.pages = root.pages;
    this.segments = root.segments;
    this.rootSegments = root.segments.kind.length;
    this.chunks = root.chunks;
    this.fileLength = preamble.fileLength;
    this.rootLength = preamble.rootLength;
    this.end = rootEnd;
    const segments = root.pages.reduce((sum, page) => sum + page.segments, root.segments.kind.length);
    if (segments > MAX_SEGMENTS) throw new CogsplatError("segment-count", `${segments} segments`);
    this.totalChunks = root.pages.reduce((sum, page) => sum + page.chunks, root.chunks.splats.length);
    const levelled = root.scene.levels.at(-1)?.chunks;
    if (levelled !== undefined && levelled !== this.totalChunks) {
      throw new CogsplatError("level-chunks", `${levelled} chunks of ${this.totalChunks}`);
    }
    // Each chunk has a head, so a page with more chunks than segments is refused when it is read.
    const mostChunks = Math.min(this.totalChunks, segments);
    this.tails = new Int32Array(mostChunks).fill(NONE);
    this.refinements = new Int32Array(mostChunks).fill(NONE);
    this.attributes = new Int32Array(mostChunks).fill(NONE);
    this.codebookSegments = root.codebooks.map(() => new Map<number, number>());
  }

  /**
   * Read preamble and root.
   *
   * @param bytes - First bytes of the file, at least to the end of the root.
   * @param sourceLength - Length of the source, compared with the length that the file states; undefined where unknown.
   * @param partial - Whether a source shorter than the file is accepted (SPEC 8.3).
   */
  static open(bytes: Uint8Array, sourceLength?: number, partial = false): SceneIndex {
    const index = new SceneIndex(bytes);
    if (sourceLength !== undefined) index.checkSource(sourceLength, partial);
    index.enterSegments(0, index.chunks.splats.length);
    return index;
  }

  /** Return the byte range of the next unread page; undefined where all are read. */
  nextPage(): ByteRange | undefined {
    const page = this.pages[this.pagesRead];
    if (page === undefined) return undefined;
    if (this.end + page.length > this.fileLength) {
      throw new CogsplatError("segments-length", `page ${this.pagesRead} leaves the file`, this.end);
    }
    return { offset: this.end, length: page.length };
  }

  /** Read the page of `nextPage`. */
  addPage(bytes: Uint8Array): void {
    const number = this.pagesRead;
    const entry = this.pages[number]!;
    const offset = this.end;
    if (crc32(bytes) !== entry.crc)
      throw new CogsplatError("page-crc", `the CRC of page ${number} does not match`, offset);
    const fields = new Fields(parseMap(bytes), `page ${number}`);
    const segments = readSegmentTable(fields.fields("segments"));
    const chunks = readChunkTable(fields.fields("chunks"));
    fields.finish();
    const span = segments.length.reduce((sum, length) => sum + length, 0);
    if (segments.kind.length !== entry.segments || chunks.splats.length !== entry.chunks || span !== entry.span) {
      throw new CogsplatError("page-entry", `page ${number} differs from its entry in the root`, offset);
    }
    const firstSegment = this.segments.kind.length;
    this.segments = joinTables(this.segments, segments);
    this.chunks = joinTables(this.chunks, chunks);
    this.end += entry.length;
    this.pagesRead++;
    this.enterSegments(firstSegment, chunks.splats.length);
  }

  /** Number of chunks available so far. */
  get chunkCount(): number {
    return this.heads.length;
  }

  /** Number of chunks of the whole file. */
  get totalChunkCount(): number {
    return this.totalChunks;
  }

  /** Whether the root and all pages are read. */
  get complete(): boolean {
    return this.pagesRead === this.pages.length;
  }

  /** Return the segments of an available chunk. */
  chunkSegments(chunk: number): ChunkSegments {
    return {
      head: this.heads[chunk]!,
      refinement: this.refinements[chunk]!,
      tail: this.tails[chunk]!,
      attributes: this.attributes[chunk]!,
      opacities: this.opacities.get(chunk) ?? NO_OPACITIES,
    };
  }

  /** Return whether a prefix of `prefix` chunks draws a chunk, or the chunk has ended (SPEC 5.10). */
  isDrawn(chunk: number, prefix: number): boolean {
    const until = this.chunks.until[chunk]!;
    return until === 0 || until > prefix;
  }

  /** Return the segment of a chunk's opacities at a level; undefined for the opacities of its head (SPEC 5.11). */
  opacitiesAt(chunk: number, level: number): number | undefined {
    const found = this.opacities.get(chunk) ?? NO_OPACITIES;
    return found[Math.min(level - this.levelsOf(chunk)[0]!, found.length) - 1];
  }

  /** Return the levels that draw a chunk. */
  levelsOf(chunk: number): number[] {
    const until = this.chunks.until[chunk]!;
    const { levels } = this.scene;
    return [...levels.keys()].filter((k) => levels[k]!.chunks > chunk && (until === 0 || levels[k]!.chunks < until));
  }

  /** Return the byte range of a segment in the file. */
  range(segment: number): ByteRange {
    return { offset: this.offsets[segment]!, length: this.segments.length[segment]! };
  }

  /**
   * Return the segments of the codebooks that a segment needs, up to the SH band of a degree.
   *
   * @returns Segment numbers; undefined where one is on an unread page.
   */
  codebookSegmentsOf(segment: number, degree: number): number[] | undefined {
    const found: number[] = [];
    const needs = this.segments.needs[segment]!;
    for (let codebook = 0; codebook < this.codebooks.length; codebook++) {
      if (((needs >>> codebook) & 1) === 0) continue;
      for (const kind of this.kindsOf(codebook, degree)) {
        const number = this.codebookSegments[codebook]!.get(kind);
        if (number === undefined) return undefined;
        found.push(number);
      }
    }
    return found;
  }

  /** Return the segments of all codebooks, used or not, codebook by codebook. */
  allCodebookSegments(): number[] {
    return this.codebookSegments.flatMap((segments) =>
      [...segments].sort(([a], [b]) => a - b).map(([, segment]) => segment),
    );
  }

  /** Refuse a payload whose CRC differs from that of the segment table. */
  checkCrc(segment: number, payload: Uint8Array): void {
    if (payload.length !== this.segments.length[segment]! || crc32(payload) !== this.segments.crc[segment]!) {
      throw new CogsplatError("segment-crc", `the CRC of segment ${segment} does not match`, this.offsets[segment]!);
    }
  }

  /** Compare the length of the source with the length that the file states (SPEC 8.3). */
  private checkSource(length: number, partial: boolean): void {
    if (length > this.fileLength) {
      throw new CogsplatError("file-trailing", `${length} bytes, the file ends at ${this.fileLength}`, this.fileLength);
    }
    if (length < this.fileLength && !partial) {
      throw new CogsplatError("file-truncated", `${length} of ${this.fileLength} bytes`, length);
    }
  }

  /**
   * Cross-check the segments read since the last call, and enter each under its chunk or codebook.
   *
   * Checks of the whole file run once all pages are read.
   */
  crossCheck(): void {
    const first = this.settled;
    this.settled = this.segments.kind.length;
    if (this.end > this.fileLength || (this.complete && this.end !== this.fileLength)) {
      throw new CogsplatError(
        "segments-length",
        `index and segments end at ${this.end}, the file at ${this.fileLength}`,
      );
    }
    this.enterHeads(first);
    this.enterOnce(first, SegmentKind.tail, this.tails, "chunk-tails");
    this.enterOnce(first, SegmentKind.refinement, this.refinements, "chunk-refinements");
    this.enterOpacities(first);
    this.checkEnds();
    this.checkSplats();
    this.checkNeeds(first);
    this.enterCodebooks(first);
    this.enterOnce(first, SegmentKind.attributes, this.attributes, "attribute-segments");
    this.enterCameras(first);
    this.enterCompensation(first);
    this.enterViewTable(first);
    this.enterDescription(first);
    this.enterPictures(first);
  }

  /** Enter the byte offsets of the segments of one table, and compare its numbers of heads and chunks. */
  private enterSegments(first: number, chunks: number): void {
    const { kind, length } = this.segments;
    const offsets = new Float64Array(kind.length);
    offsets.set(this.offsets);
    let heads = 0;
    for (let i = first; i < kind.length; i++) {
      offsets[i] = this.end;
      this.end += length[i]!;
      if (kind[i] === SegmentKind.head) heads++;
    }
    this.offsets = offsets;
    if (heads !== chunks) throw new CogsplatError("chunk-heads", `an index of ${heads} heads and ${chunks} chunks`);
  }

  private enterHeads(first: number): void {
    for (const [segment, owner] of this.ofKind(SegmentKind.head, first)) {
      if (owner !== this.heads.length) {
        throw new CogsplatError("chunk-heads", `a head of chunk ${owner}, expected chunk ${this.heads.length}`);
      }
      this.heads.push(segment);
    }
  }

  /** Enter the segments of a kind that a chunk has at most once, always after its head. */
  private enterOnce(
    first: number,
    kind: number,
    table: Int32Array,
    code: "chunk-tails" | "chunk-refinements" | "attribute-segments",
  ): void {
    const isAllowed =
      code === "chunk-tails"
        ? this.scene.shDegree > 0
        : code !== "attribute-segments" || this.scene.attributes.length > 0;
    for (const [segment, chunk] of this.ofKind(kind, first)) {
      const head = this.heads[chunk];
      if (!isAllowed) throw new CogsplatError(code, `segment ${segment} has no place in this scene`);
      if (head === undefined || head > segment || table[chunk] !== NONE) {
        throw new CogsplatError(
          code,
          `segment ${segment} of chunk ${chunk} is its second, before its head, or of no chunk`,
        );
      }
      table[chunk] = segment;
    }
  }

  /** Enter the opacities of later levels, after their chunks' heads and at most one per level. */
  private enterOpacities(first: number): void {
    for (const [segment, chunk] of this.ofKind(SegmentKind.opacities, first)) {
      const head = this.heads[chunk];
      const found = this.opacities.get(chunk) ?? [];
      if (head === undefined || head > segment || found.length >= this.levelsOf(chunk).length - 1) {
        throw new CogsplatError("chunk-opacities", `segment ${segment} of chunk ${chunk} has no place`);
      }
      this.opacities.set(chunk, [...found, segment]);
    }
  }

  private checkEnds(): void {
    this.chunks.until.forEach((until, chunk) => {
      if (until > 0 && (until < chunk + 2 || until > this.totalChunks)) {
        throw new CogsplatError("chunk-until", `chunk ${chunk} ends at ${until}`);
      }
    });
  }

  private checkSplats(): void {
    const splats = this.chunks.splats.reduce((sum, rows) => sum + rows, 0);
    // Chunks of unread pages have the rest.
    if (splats > this.scene.splats || (this.complete && splats !== this.scene.splats)) {
      throw new CogsplatError("splat-count", `chunks of ${splats} splats, the root says ${this.scene.splats}`);
    }
  }

  private checkNeeds(first: number): void {
    const count = this.codebooks.length;
    const wrong = count < 32 ? this.segments.needs.subarray(first).findIndex((needs) => needs >>> count !== 0) : -1;
    if (wrong >= 0) {
      throw new CogsplatError("needs-range", `segment ${first + wrong} needs a codebook that is not listed`);
    }
  }

  private enterCodebooks(first: number): void {
    for (const kind of [
      SegmentKind.shapeCodebook,
      SegmentKind.colourBand1,
      SegmentKind.colourBand2,
      SegmentKind.colourBand3,
    ]) {
      for (const [segment, codebook] of this.ofKind(kind, first)) {
        const segments = this.codebookSegments[codebook];
        if (
          segments === undefined ||
          segments.has(kind) ||
          !this.kindsOf(codebook, this.scene.shDegree).includes(kind)
        ) {
          throw new CogsplatError(
            "codebook-segments",
            `segment ${segment} of kind ${kind} has no place in codebook ${codebook}`,
          );
        }
        segments.set(kind, segment);
      }
    }
    if (!this.complete) return;
    this.codebooks.forEach((_, codebook) => {
      const missing = this.kindsOf(codebook, this.scene.shDegree).find(
        (kind) => !this.codebookSegments[codebook]!.has(kind),
      );
      if (missing !== undefined) {
        throw new CogsplatError("codebook-segments", `codebook ${codebook} has no segment of kind ${missing}`);
      }
    });
  }

  private enterCameras(first: number): void {
    for (const [segment, owner] of this.ofKind(SegmentKind.cameras, first)) {
      if (owner !== 0 || this.cameras.length > 0) {
        throw new CogsplatError("camera-segments", `a segment of cameras of owner ${owner}, or a second one`);
      }
      this.cameras.push(segment);
    }
  }

  private enterViewTable(first: number): void {
    for (const [segment, owner] of this.ofKind(SegmentKind.viewTable, first)) {
      if (owner !== 0 || this.viewTables.length > 0) {
        throw new CogsplatError("view-table-segments", `a view table of owner ${owner}, or a second one`);
      }
      this.viewTables.push(segment);
    }
  }

  private enterDescription(first: number): void {
    for (const [segment, owner] of this.ofKind(SegmentKind.description, first)) {
      const length = this.segments.length[segment]!;
      if (owner !== 0 || this.description !== undefined || segment >= this.rootSegments || length > MAX_DESCRIPTION) {
        throw new CogsplatError(
          "description-segments",
          `a description of owner ${owner} and ${length} bytes in a page, or a second one`,
        );
      }
      this.description = segment;
    }
  }

  private enterPictures(first: number): void {
    // The last index lists the pictures.
    const last = this.pages.slice(0, -1).reduce((sum, page) => sum + page.segments, this.rootSegments);
    for (const [segment, owner] of this.ofKind(SegmentKind.picture, first)) {
      const name = PICTURE_NAMES[owner];
      const length = this.segments.length[segment]!;
      const isEarly = this.pages.length > 0 && segment < last;
      if (
        name === undefined ||
        this.pictures.has(name) ||
        isEarly ||
        this.description === undefined ||
        length > MAX_PICTURE
      ) {
        throw new CogsplatError("description-segments", `a picture of owner ${owner} and ${length} bytes has no place`);
      }
      this.pictures.set(name, segment);
    }
  }

  private enterCompensation(first: number): void {
    for (const [segment, layer] of this.ofKind(SegmentKind.compensation, first)) {
      if (layer !== this.compensation.length) {
        throw new CogsplatError("compensation-segments", `layer ${layer}, expected ${this.compensation.length}`);
      }
      this.compensation.push(segment);
    }
  }

  /** Iterate over the segments of a kind from a row on, each with its owner. */
  private *ofKind(wanted: number, first: number): Generator<readonly [number, number]> {
    const { kind, owner } = this.segments;
    for (let i = first; i < kind.length; i++) if (kind[i] === wanted) yield [i, owner[i]!];
  }

  /** Return the segment kinds of a codebook: the shape kind, or the colour bands up to an SH degree. */
  private kindsOf(codebook: number, degree: number): readonly number[] {
    if (this.codebooks[codebook]!.attribute === "shape") return [SegmentKind.shapeCodebook];
    return [SegmentKind.colourBand1, SegmentKind.colourBand2, SegmentKind.colourBand3].slice(0, degree);
  }
}
