import { CogsplatError, type ReasonCode } from "../errors.js";
import { crc32 } from "./crc32.js";
import { PICTURE_NAMES, type PictureName } from "./description.js";
import { type IndexTables, IndexTree } from "./index_tree.js";
import type { ByteRange, Index, Page } from "./indexes.js";
import { PREAMBLE_BYTES, type Preamble, readPreamble } from "./preamble.js";
import { type CodebookEntry, type Root, readRoot, type SceneInfo } from "./root.js";
import { SegmentKind } from "./tables.js";

export type { ByteRange, Index, Page } from "./indexes.js";

/** Bytes of a description, and of a picture, at most (SPEC 9.1). */
const MAX_DESCRIPTION = 1_048_576;
const MAX_PICTURE = 16_777_216;
const COLOUR_BANDS = [SegmentKind.colourBand1, SegmentKind.colourBand2, SegmentKind.colourBand3] as const;
/** Segment number of a kind that a chunk does not have. */
const NONE = -1;

/** Byte ranges of a scene's segments and pages, in a file or in the objects of a folder. */
export interface ScenePlaces {
  /** Return the byte range of a segment. */
  range(segment: number): ByteRange;
  /** Return the byte range of a page. */
  pageRange(page: Page): ByteRange;
  /** Check and enter a page, unless it was read before. */
  addPage(page: Page, bytes: Uint8Array): void;
}

/** Segment numbers of one chunk; −1 for a kind that it does not have. */
export interface ChunkSegments {
  readonly head: number;
  readonly refinement: number;
  readonly tail: number;
  readonly attributes: number;
  /** Segments of opacities at later levels, in the order of the levels. */
  readonly opacities: readonly number[];
}

/** Segments of a chunk while they are entered. */
interface OwnSegments extends ChunkSegments {
  refinement: number;
  tail: number;
  attributes: number;
  readonly opacities: number[];
}

/**
 * The index of a file: the root and the pages read so far (SPEC 3 to 5).
 *
 * Files are refused in the order of SPEC 8.1: each index is checked alone, when it is read.
 */
export class SceneIndex extends IndexTree implements ScenePlaces {
  readonly scene: SceneInfo;
  readonly codebooks: readonly CodebookEntry[];
  readonly fileLength: number;
  readonly rootLength: number;
  /** Segments of compensation and cameras, in file order. */
  readonly compensation: number[] = [];
  readonly cameras: number[] = [];
  /** View table of each index that has one (SPEC 5.12). */
  readonly viewTables = new Map<Index, number>();
  private readonly descriptions: number[] = [];
  /** Segments of the pictures, by name. */
  readonly pictures = new Map<PictureName, number>();

  private readonly parts = new Map<number, OwnSegments>();
  /** Segment of each kind, for each codebook. */
  private readonly codebookSegments: Map<number, number>[];

  private constructor(preamble: Preamble, root: Root) {
    super(root, PREAMBLE_BYTES + preamble.rootLength);
    this.scene = root.scene;
    this.codebooks = root.codebooks;
    this.fileLength = preamble.fileLength;
    this.rootLength = preamble.rootLength;
    this.codebookSegments = root.codebooks.map(() => new Map<number, number>());
  }

  /**
   * Read and check preamble and root.
   *
   * @param bytes - First bytes of the file, at least to the end of the root.
   * @param sourceLength - Length of the source, compared with the length that the file states; undefined where unknown.
   * @param partial - Whether a source shorter than the file is accepted (SPEC 8.3).
   */
  static open(bytes: Uint8Array, sourceLength?: number, partial = false): SceneIndex {
    const index = SceneIndex.begin(bytes);
    if (sourceLength !== undefined) index.checkSource(sourceLength, partial);
    index.checkRoot();
    return index;
  }

  /** Read preamble and root; `checkRoot` follows once other checks of the source have passed. */
  static begin(bytes: Uint8Array): SceneIndex {
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
    return new SceneIndex(preamble, readRoot(rootBytes));
  }

  /** Segment of the description; undefined where there is none. */
  get description(): number | undefined {
    return this.descriptions[0];
  }

  /** Return the byte range of a page in the file. */
  pageRange(page: Page): ByteRange {
    return page;
  }

  /** Enter the tables of an unread page, and check its segments. */
  override enterPage(page: Page, tables: IndexTables): Index {
    const index = super.enterPage(page, tables);
    this.enterSegments(index);
    return index;
  }

  addPage(page: Page, bytes: Uint8Array): void {
    if (!this.isRead(page)) this.enterPage(page, this.readPage(page, bytes));
  }

  /** Return the segments of an available chunk. */
  chunkSegments(chunk: number): ChunkSegments {
    return this.parts.get(chunk)!;
  }

  /** Return whether a prefix of `prefix` chunks draws a chunk, or the chunk has ended (SPEC 5.10). */
  isDrawn(chunk: number, prefix: number): boolean {
    const until = this.chunks.until[chunk]!;
    return until === 0 || until > prefix;
  }

  /** Return the segment of a chunk's opacities at a level; undefined for the opacities of its head (SPEC 5.11). */
  opacitiesAt(chunk: number, level: number): number | undefined {
    const found = this.parts.get(chunk)!.opacities;
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
    return { offset: this.segments.offset[segment]!, length: this.segments.length[segment]! };
  }

  /** Return the segments of the codebooks that a segment needs, up to the SH band of a degree. */
  codebookSegmentsOf(segment: number, degree: number): number[] {
    const needs = this.segments.needs[segment]!;
    return this.codebookSegments.flatMap((segments, codebook) =>
      ((needs >>> codebook) & 1) === 0 ? [] : this.kindsOf(codebook, degree).map((kind) => segments.get(kind)!),
    );
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
      throw new CogsplatError(
        "segment-crc",
        `the CRC of segment ${segment} does not match`,
        this.segments.offset[segment]!,
      );
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

  /** Check what the root states of the whole file, then its own segments and chunks. */
  checkRoot(): void {
    this.checkCount();
    const { total, end } = this;
    if (end !== this.fileLength) {
      const found = `root, segments and pages end at ${end}, the file at ${this.fileLength}`;
      throw new CogsplatError("segments-length", found);
    }
    if (total.splats !== this.scene.splats) {
      throw new CogsplatError("splat-count", `chunks of ${total.splats} splats, the root says ${this.scene.splats}`);
    }
    const levelled = this.scene.levels.at(-1)?.chunks;
    if (levelled !== undefined && levelled !== total.chunks) {
      throw new CogsplatError("level-chunks", `${levelled} chunks of ${total.chunks}`);
    }
    this.enterSegments(this.root);
  }

  /** Check the segments and chunks of an index, and enter each segment under its chunk or codebook. */
  private enterSegments(index: Index): void {
    this.enterHeads(index);
    this.enterOnce(index, SegmentKind.tail, "tail", "chunk-tails", this.scene.shDegree > 0);
    this.enterOnce(index, SegmentKind.refinement, "refinement", "chunk-refinements", true);
    this.enterOpacities(index);
    this.checkEnds(index);
    this.checkNeeds(index);
    this.enterCodebooks(index);
    const hasAttributes = this.scene.attributes.length > 0;
    this.enterOnce(index, SegmentKind.attributes, "attributes", "attribute-segments", hasAttributes);
    this.enterOfRoot(index, SegmentKind.cameras, "camera-segments", this.cameras, 1);
    this.enterOfRoot(index, SegmentKind.compensation, "compensation-segments", this.compensation, Infinity);
    this.enterViewTable(index);
    this.enterDescription(index);
  }

  private enterHeads(index: Index): void {
    let next = index.firstChunk;
    for (const [head, owner] of this.ofKind(SegmentKind.head, index)) {
      if (owner !== next) throw this.misplaced("chunk-heads", head);
      this.parts.set(next++, { head, refinement: NONE, tail: NONE, attributes: NONE, opacities: [] });
    }
    const heads = next - index.firstChunk;
    if (heads !== index.chunkCount)
      throw new CogsplatError("chunk-heads", `${heads} heads of ${index.chunkCount} chunks`);
  }

  /** Return the segments of a chunk of an index whose head is before a segment. */
  private partsBefore(segment: number, chunk: number, { firstChunk, chunkCount }: Index): OwnSegments | undefined {
    const parts = chunk >= firstChunk && chunk < firstChunk + chunkCount ? this.parts.get(chunk) : undefined;
    return parts && parts.head < segment ? parts : undefined;
  }

  /** Enter the segments of a kind that a chunk has at most once, always after its head and in its index. */
  private enterOnce(
    index: Index,
    kind: number,
    part: "tail" | "refinement" | "attributes",
    code: ReasonCode,
    isAllowed: boolean,
  ): void {
    for (const [segment, chunk] of this.ofKind(kind, index)) {
      const parts = this.partsBefore(segment, chunk, index);
      if (!isAllowed || parts?.[part] !== NONE) throw this.misplaced(code, segment);
      parts[part] = segment;
    }
  }

  /** Enter the opacities of later levels, after their chunks' heads and at most one per level. */
  private enterOpacities(index: Index): void {
    for (const [segment, chunk] of this.ofKind(SegmentKind.opacities, index)) {
      const found = this.partsBefore(segment, chunk, index)?.opacities;
      if (found === undefined || found.length >= this.levelsOf(chunk).length - 1) {
        throw this.misplaced("chunk-opacities", segment);
      }
      found.push(segment);
    }
  }

  private checkEnds({ firstChunk, chunkCount }: Index): void {
    for (let chunk = firstChunk; chunk < firstChunk + chunkCount; chunk++) {
      const until = this.chunks.until[chunk]!;
      if (until > 0 && (until < chunk + 2 || until > this.total.chunks)) {
        throw new CogsplatError("chunk-until", `chunk ${chunk} ends at ${until}`);
      }
    }
  }

  private checkNeeds({ firstSegment, segmentCount }: Index): void {
    const count = this.codebooks.length;
    for (let segment = firstSegment; segment < firstSegment + segmentCount; segment++) {
      // A shift by 32 is one by 0.
      if (count < 32 && this.segments.needs[segment]! >>> count !== 0) {
        throw new CogsplatError("needs-range", `segment ${segment} needs a codebook that is not listed`);
      }
    }
  }

  /** Enter the codebooks, which the root lists. */
  private enterCodebooks(index: Index): void {
    for (const kind of [SegmentKind.shapeCodebook, ...COLOUR_BANDS]) {
      for (const [segment, codebook] of this.ofKind(kind, index)) {
        const segments = index.page === undefined ? this.codebookSegments[codebook] : undefined;
        const isAllowed = segments && !segments.has(kind) && this.kindsOf(codebook, this.scene.shDegree).includes(kind);
        if (!isAllowed) throw this.misplaced("codebook-segments", segment);
        segments.set(kind, segment);
      }
    }
    this.codebookSegments.forEach((segments, codebook) => {
      const missing = this.kindsOf(codebook, this.scene.shDegree).find((kind) => !segments.has(kind));
      if (missing !== undefined) {
        throw new CogsplatError("codebook-segments", `codebook ${codebook} has no segment of kind ${missing}`);
      }
    });
  }

  /** Enter the segments of a kind that the root lists, owned by 0, 1 and so on, at most `most` of them. */
  private enterOfRoot(index: Index, kind: number, code: ReasonCode, found: number[], most: number): void {
    for (const [segment, owner] of this.ofKind(kind, index)) {
      if (index.page !== undefined || owner !== found.length || owner >= most) throw this.misplaced(code, segment);
      found.push(segment);
    }
  }

  private enterViewTable(index: Index): void {
    for (const [segment, owner] of this.ofKind(SegmentKind.viewTable, index)) {
      if (owner !== 0 || this.viewTables.has(index)) throw this.misplaced("view-table-segments", segment);
      this.viewTables.set(index, segment);
    }
  }

  /** Page that lists the pictures: the last one that the root lists; undefined for the root. */
  get picturesPage(): Page | undefined {
    return this.root.pages.at(-1);
  }

  private enterDescription(index: Index): void {
    this.enterOfRoot(index, SegmentKind.description, "description-segments", this.descriptions, 1);
    for (const [segment, owner] of this.ofKind(SegmentKind.picture, index)) {
      const name = PICTURE_NAMES[owner];
      const isAllowed = index.page === this.picturesPage && this.description !== undefined;
      if (!isAllowed || name === undefined || this.pictures.has(name)) {
        throw this.misplaced("description-segments", segment);
      }
      this.pictures.set(name, segment);
    }
    for (const [segments, most] of [
      [this.descriptions, MAX_DESCRIPTION],
      [this.pictures.values(), MAX_PICTURE],
    ] as const) {
      for (const segment of segments) {
        const length = this.segments.length[segment]!;
        if (length > most) throw new CogsplatError("description-segments", `${length} bytes, at most ${most}`);
      }
    }
  }

  /** Return the error of a segment that the index of its owner does not list, or more than once. */
  private misplaced(code: ReasonCode, segment: number): CogsplatError {
    const { kind, owner } = this.segments;
    return new CogsplatError(
      code,
      `segment ${segment} of kind ${kind[segment]} and owner ${owner[segment]} has no place`,
    );
  }

  /** Iterate over the segments of a kind that an index lists, each with its owner. */
  private *ofKind(wanted: number, { firstSegment, segmentCount }: Index): Generator<readonly [number, number]> {
    const { kind, owner } = this.segments;
    for (let i = firstSegment; i < firstSegment + segmentCount; i++) if (kind[i] === wanted) yield [i, owner[i]!];
  }

  /** Return the segment kinds of a codebook: the shape kind, or the colour bands up to an SH degree. */
  private kindsOf(codebook: number, degree: number): readonly number[] {
    if (this.codebooks[codebook]!.attribute === "shape") return [SegmentKind.shapeCodebook];
    return COLOUR_BANDS.slice(0, degree);
  }
}
