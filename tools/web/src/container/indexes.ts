/** A byte range of a file or of an address space. */
export interface ByteRange {
  readonly offset: number;
  readonly length: number;
}

/** A page of the index, as the index that lists it announces it (SPEC 5.6). */
export interface Page extends ByteRange {
  /** Place in `IndexTree.pages`. */
  readonly number: number;
  readonly crc: number;
  /** Segments, chunks, bytes and splats below the page. */
  readonly segments: number;
  readonly chunks: number;
  readonly span: number;
  readonly splats: number;
  readonly contribution: number;
  /** Numbers of the first segment, chunk and splat below the page. */
  readonly firstSegment: number;
  readonly firstChunk: number;
  readonly firstSplat: number;
  /** Row in `SceneRows`. */
  readonly row: number;
  readonly listedBy: Index;
}

/** The root or a page that was read (SPEC 5.6). */
export interface Index {
  /** The page; undefined for the root. */
  readonly page: Page | undefined;
  /** Number of pages on the path from the root. */
  readonly depth: number;
  /** Offset of its first byte, 0 for the root. */
  readonly start: number;
  /** Offset of the end of its own segments, where its first page begins. */
  readonly segmentsEnd: number;
  /** Numbers of its first segment and chunk, with the counts of its own. */
  readonly firstSegment: number;
  readonly segmentCount: number;
  readonly firstChunk: number;
  readonly chunkCount: number;
  readonly pages: readonly Page[];
  /** First row in `SceneRows`. */
  readonly firstRow: number;
  /** Boxes and contributions of its own chunks, then of its pages. */
  readonly boxes: Float32Array;
  readonly contribution: Float64Array;
}
