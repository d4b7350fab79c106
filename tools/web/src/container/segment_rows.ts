import { CogsplatError, type ReasonCode } from "../errors.js";
import { PICTURE_NAMES, type PictureName } from "./description.js";
import type { IndexTables } from "./index_tree.js";
import type { CodebookEntry, SceneInfo } from "./root.js";
import { SegmentKind } from "./tables.js";

/** Bytes of the description and of a picture at most (SPEC 9.1). */
const MAX_DESCRIPTION = 1_048_576;
const MAX_PICTURE = 16_777_216;
const COLOUR_BANDS = [SegmentKind.colourBand1, SegmentKind.colourBand2, SegmentKind.colourBand3] as const;
/** Segment that a chunk does not have. */
const NONE = -1;

/** Segments of a chunk by part; −1 for a part that the chunk does not have. */
export interface ChunkSegments {
  readonly head: number;
  readonly refinement: number;
  readonly tail: number;
  readonly attributes: number;
  /** Segments of opacities at later levels, in the order of the levels. */
  readonly opacities: readonly number[];
}

/** Segments of a chunk while they are found. */
interface OwnSegments extends ChunkSegments {
  refinement: number;
  tail: number;
  attributes: number;
  readonly opacities: number[];
}

/** The file of an index, and the place of the index in it. */
export interface IndexPlace {
  readonly scene: SceneInfo;
  readonly codebooks: readonly CodebookEntry[];
  /** Chunks of the whole file. */
  readonly totalChunks: number;
  readonly isRoot: boolean;
  readonly firstSegment: number;
  readonly firstChunk: number;
  /** Whether the index may list pictures (SPEC 5.14): the root, or its last page in a file with a description. */
  readonly mayListPictures: boolean;
}

/** Return the levels that draw a chunk, which ends at `until`; 0 for a chunk that all later levels draw (SPEC 5.10). */
export function levelsDrawing(levels: SceneInfo["levels"], chunk: number, until: number): number[] {
  return [...levels.keys()].filter((k) => levels[k]!.chunks > chunk && (until === 0 || levels[k]!.chunks < until));
}

/** Return the segment kinds of a codebook: the shape kind, or the colour bands up to an SH degree. */
export function codebookKinds({ attribute }: CodebookEntry, degree: number): readonly number[] {
  return attribute === "shape" ? [SegmentKind.shapeCodebook] : COLOUR_BANDS.slice(0, degree);
}

/**
 * Segments of one index by chunk and by kind, with the checks of SPEC 5 in the order of SPEC 8.1.
 *
 * The checks read the tables of the index alone. So a page that breaks a rule is refused before it is entered.
 */
export class SegmentRows {
  /** Segments of the chunks of the index. */
  readonly chunks: OwnSegments[] = [];
  /** Segment of each kind, for each codebook of the root. */
  readonly codebooks: Map<number, number>[];
  /** Segments of cameras, compensation, view table and description, in file order. */
  readonly cameras: number[] = [];
  readonly compensation: number[] = [];
  readonly viewTables: number[] = [];
  readonly descriptions: number[] = [];
  /** Segments of the pictures, by name. */
  readonly pictures = new Map<PictureName, number>();

  constructor(
    private readonly place: IndexPlace,
    private readonly tables: IndexTables,
  ) {
    this.codebooks = place.isRoot ? place.codebooks.map(() => new Map<number, number>()) : [];
    const { scene } = place;
    this.findHeads();
    this.findOnce(SegmentKind.tail, "tail", "chunk-tails", scene.shDegree > 0);
    this.findOnce(SegmentKind.refinement, "refinement", "chunk-refinements", true);
    this.findOpacities();
    this.checkEnds();
    this.checkNeeds();
    this.findCodebooks();
    this.findOnce(SegmentKind.attributes, "attributes", "attribute-segments", scene.attributes.length > 0);
    const { isRoot } = place;
    this.findNumbered(SegmentKind.cameras, "camera-segments", this.cameras, isRoot ? 1 : 0);
    this.findNumbered(SegmentKind.compensation, "compensation-segments", this.compensation, isRoot ? Infinity : 0);
    this.findNumbered(SegmentKind.viewTable, "view-table-segments", this.viewTables, 1);
    this.findNumbered(SegmentKind.description, "description-segments", this.descriptions, isRoot ? 1 : 0);
    this.findPictures();
  }

  private findHeads(): void {
    const { firstChunk } = this.place;
    for (const [head, owner] of this.ofKind(SegmentKind.head)) {
      if (owner !== firstChunk + this.chunks.length) throw this.misplaced("chunk-heads", head);
      this.chunks.push({ head, refinement: NONE, tail: NONE, attributes: NONE, opacities: [] });
    }
    const [heads, chunks] = [this.chunks.length, this.tables.chunks.splats.length];
    if (heads !== chunks) throw new CogsplatError("chunk-heads", `${heads} heads of ${chunks} chunks`);
  }

  /** Return the segments of a chunk of the index whose head is before a segment. */
  private partsBefore(segment: number, chunk: number): OwnSegments | undefined {
    const parts = this.chunks[chunk - this.place.firstChunk];
    return parts && parts.head < segment ? parts : undefined;
  }

  /** Find the segments of a kind that a chunk has at most once, always after its head and in its index. */
  private findOnce(
    kind: number,
    part: "tail" | "refinement" | "attributes",
    code: ReasonCode,
    isAllowed: boolean,
  ): void {
    for (const [segment, chunk] of this.ofKind(kind)) {
      const parts = this.partsBefore(segment, chunk);
      if (!isAllowed || parts?.[part] !== NONE) throw this.misplaced(code, segment);
      parts[part] = segment;
    }
  }

  /** Find the opacities of later levels, after their chunks' heads and at most one per level. */
  private findOpacities(): void {
    const { scene, firstChunk } = this.place;
    for (const [segment, chunk] of this.ofKind(SegmentKind.opacities)) {
      const found = this.partsBefore(segment, chunk)?.opacities;
      const until = this.tables.chunks.until[chunk - firstChunk]!;
      if (found === undefined || found.length >= levelsDrawing(scene.levels, chunk, until).length - 1) {
        throw this.misplaced("chunk-opacities", segment);
      }
      found.push(segment);
    }
  }

  private checkEnds(): void {
    const { firstChunk, totalChunks } = this.place;
    for (const [i, until] of this.tables.chunks.until.entries()) {
      const chunk = firstChunk + i;
      if (until > 0 && (until < chunk + 2 || until > totalChunks)) {
        throw new CogsplatError("chunk-until", `chunk ${chunk} ends at ${until}`);
      }
    }
  }

  private checkNeeds(): void {
    const count = this.place.codebooks.length;
    // A shift by 32 is one by 0.
    const wrong = count < 32 ? this.tables.segments.needs.findIndex((needs) => needs >>> count !== 0) : -1;
    if (wrong >= 0) {
      const segment = this.place.firstSegment + wrong;
      throw new CogsplatError("needs-range", `segment ${segment} needs a codebook that is not listed`);
    }
  }

  /** Find the segments of the codebooks, which the root lists. */
  private findCodebooks(): void {
    const { codebooks, scene } = this.place;
    for (const kind of [SegmentKind.shapeCodebook, ...COLOUR_BANDS]) {
      for (const [segment, codebook] of this.ofKind(kind)) {
        const segments = this.codebooks[codebook];
        const isAllowed =
          segments && !segments.has(kind) && codebookKinds(codebooks[codebook]!, scene.shDegree).includes(kind);
        if (!isAllowed) throw this.misplaced("codebook-segments", segment);
        segments.set(kind, segment);
      }
    }
    this.codebooks.forEach((segments, codebook) => {
      const missing = codebookKinds(codebooks[codebook]!, scene.shDegree).find((kind) => !segments.has(kind));
      if (missing !== undefined) {
        throw new CogsplatError("codebook-segments", `codebook ${codebook} has no segment of kind ${missing}`);
      }
    });
  }

  /** Find the segments of a kind that are owned by 0, 1 and so on, at most `most` of them. */
  private findNumbered(kind: number, code: ReasonCode, found: number[], most: number): void {
    for (const [segment, owner] of this.ofKind(kind)) {
      if (owner !== found.length || owner >= most) throw this.misplaced(code, segment);
      found.push(segment);
    }
  }

  private findPictures(): void {
    const mayListPictures = this.place.mayListPictures && (!this.place.isRoot || this.descriptions.length > 0);
    for (const [segment, owner] of this.ofKind(SegmentKind.picture)) {
      const name = PICTURE_NAMES[owner];
      if (!mayListPictures || name === undefined || this.pictures.has(name)) {
        throw this.misplaced("description-segments", segment);
      }
      this.pictures.set(name, segment);
    }
    for (const [segments, most] of [
      [this.descriptions, MAX_DESCRIPTION],
      [this.pictures.values(), MAX_PICTURE],
    ] as const) {
      for (const segment of segments) {
        const length = this.tables.segments.length[segment - this.place.firstSegment]!;
        if (length > most) throw new CogsplatError("description-segments", `${length} bytes, at most ${most}`);
      }
    }
  }

  /** Return the error of a segment that the index of its owner does not list, or more than once. */
  private misplaced(code: ReasonCode, segment: number): CogsplatError {
    const { kind, owner } = this.tables.segments;
    const row = segment - this.place.firstSegment;
    return new CogsplatError(code, `segment ${segment} of kind ${kind[row]} and owner ${owner[row]} has no place`);
  }

  /** Iterate over the segments of a kind, each with its owner. */
  private *ofKind(wanted: number): Generator<readonly [number, number]> {
    const { kind, owner } = this.tables.segments;
    for (const [row, of] of kind.entries()) if (of === wanted) yield [this.place.firstSegment + row, owner[row]!];
  }
}
