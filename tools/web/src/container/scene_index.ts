import { CogsplatError } from "../errors.js";
import { crc32 } from "./crc32.js";
import type { PictureName } from "./description.js";
import { type IndexTables, IndexTree } from "./index_tree.js";
import type { ByteRange, Index, Page } from "./indexes.js";
import { PREAMBLE_BYTES, type Preamble, readPreamble } from "./preamble.js";
import { type CodebookEntry, type Root, readRoot, type SceneInfo } from "./root.js";
import { type ChunkSegments, codebookKinds, levelsDrawing, SegmentRows } from "./segment_rows.js";

export type { ByteRange, Index, Page } from "./indexes.js";
export type { ChunkSegments } from "./segment_rows.js";

/** Byte ranges of a scene's segments and pages, in a file or in the objects of a folder. */
export interface ScenePlaces {
  /** Return the byte range of a segment. */
  range(segment: number): ByteRange;
  /** Return the byte range of a page. */
  pageRange(page: Page): ByteRange;
  /** Check and enter a page, unless it was read before. */
  addPage(page: Page, bytes: Uint8Array): void;
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
  /** View table of each index that has one (SPEC 5.12). */
  readonly viewTables = new Map<Index, number>();
  /** Segments of the pictures, by name. */
  readonly pictures = new Map<PictureName, number>();

  private readonly parts = new Map<number, ChunkSegments>();
  /** Segments that the root lists; undefined until `checkRoot`. */
  private rootRows: SegmentRows | undefined;

  private constructor(
    preamble: Preamble,
    private readonly rootTables: Root,
  ) {
    const root = rootTables;
    super(root, PREAMBLE_BYTES + preamble.rootLength);
    this.scene = root.scene;
    this.codebooks = root.codebooks;
    this.fileLength = preamble.fileLength;
    this.rootLength = preamble.rootLength;
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

  /** Segments of the cameras, one at most, and of compensation, in file order. */
  get cameras(): readonly number[] {
    return this.rootRows!.cameras;
  }

  get compensation(): readonly number[] {
    return this.rootRows!.compensation;
  }

  /** Segment of the description; undefined where there is none. */
  get description(): number | undefined {
    return this.rootRows!.descriptions[0];
  }

  /** Return the byte range of a page in the file. */
  pageRange(page: Page): ByteRange {
    return page;
  }

  /** Enter the tables of an unread page after a check of its segments: a page that is refused stays unread. */
  override enterPage(page: Page, tables: IndexTables): Index {
    const rows = this.rowsOf(tables, page);
    const index = super.enterPage(page, tables);
    this.enterRows(index, rows);
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
    return levelsDrawing(this.scene.levels, chunk, this.chunks.until[chunk]!);
  }

  /** Return the byte range of a segment in the file. */
  range(segment: number): ByteRange {
    return { offset: this.segments.offset[segment]!, length: this.segments.length[segment]! };
  }

  /** Return the segments of the codebooks that a segment needs, up to the SH band of a degree. */
  codebookSegmentsOf(segment: number, degree: number): number[] {
    const needs = this.segments.needs[segment]!;
    return this.rootRows!.codebooks.flatMap((segments, codebook) =>
      ((needs >>> codebook) & 1) === 0
        ? []
        : codebookKinds(this.codebooks[codebook]!, degree).map((kind) => segments.get(kind)!),
    );
  }

  /** Return the segments of all codebooks, used or not, codebook by codebook. */
  allCodebookSegments(): number[] {
    return this.rootRows!.codebooks.flatMap((segments) =>
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
    this.rootRows = this.rowsOf(this.rootTables);
    this.enterRows(this.root, this.rootRows);
  }

  /** Find and check the segments of an index, before it is entered. */
  private rowsOf(tables: IndexTables, page?: Page): SegmentRows {
    return new SegmentRows(
      {
        scene: this.scene,
        codebooks: this.codebooks,
        totalChunks: this.total.chunks,
        isRoot: page === undefined,
        firstSegment: page?.firstSegment ?? 0,
        firstChunk: page?.firstChunk ?? 0,
        mayListPictures: page === this.picturesPage && (page === undefined || this.description !== undefined),
      },
      tables,
    );
  }

  private enterRows(index: Index, rows: SegmentRows): void {
    for (const [i, parts] of rows.chunks.entries()) this.parts.set(index.firstChunk + i, parts);
    for (const segment of rows.viewTables) this.viewTables.set(index, segment);
    for (const [name, segment] of rows.pictures) this.pictures.set(name, segment);
  }

  /** Page that lists the pictures: the last one that the root lists; undefined for the root. */
  get picturesPage(): Page | undefined {
    return this.root.pages.at(-1);
  }
}
