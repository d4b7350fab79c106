import type { Index, Page } from "./indexes.js";
import type { ChunkTable } from "./tables.js";

/**
 * Chunks and pages of the indexes read so far, as rows of one table (SPEC 5.6): of each index in the order of reading, its
 * own chunks, then the pages that it lists.
 *
 * A page that was not read stands for all chunks below it.
 */
export class SceneRows {
  /** Splats of each row. */
  readonly splats: number[] = [];
  /** Number of each chunk; of a page that of its first chunk. */
  readonly chunks: number[] = [];
  /** Row of the parent (SPEC 5.4), always an earlier one; −1 for none. */
  readonly parents: number[] = [];
  /** The page of each row that is one. */
  readonly pages: (Page | undefined)[] = [];
  /** Whether all known chunks are cut by cell. */
  isCut = true;
  private readonly rowOfChunk = new Map<number, number>();
  /** First splat of each chunk and page, by the number of its first chunk. */
  private readonly starts = new Map<number, number>();
  /** Index that lists each row. */
  private readonly listing: Index[] = [];
  /** Last own chunk of each cell, for each index. */
  private readonly lastOfCell = new Map<Index, Map<number, number>>();
  private readonly indexes = new Map<Page, Index>();
  private root: Index | undefined;

  /** Number of rows. */
  get count(): number {
    return this.splats.length;
  }

  /** Enter an index whose own chunks and pages are known. */
  enter(index: Index, { splats, cell }: Pick<ChunkTable, "splats" | "cell">, pageCells: ArrayLike<number>): void {
    if (index.page === undefined) this.root = index;
    else this.indexes.set(index.page, index);
    const lastOfCell = new Map<number, number>();
    this.lastOfCell.set(index, lastOfCell);
    let start = index.page?.firstSplat ?? 0;
    for (let i = 0; i < index.chunkCount; i++) {
      const row = this.push(index, index.firstChunk + i, splats[i]!, start, cell[i]!);
      lastOfCell.set(cell[i]!, row);
      this.rowOfChunk.set(index.firstChunk + i, row);
      this.isCut &&= cell[i]! > 0;
      start += splats[i]!;
    }
    for (const [i, page] of index.pages.entries()) {
      const row = this.push(index, page.firstChunk, page.splats, start, pageCells[i] ?? 0);
      this.pages[row] = page;
      start += page.splats;
    }
    const last = index.pages.at(-1);
    this.starts.set(last === undefined ? index.firstChunk + index.chunkCount : last.firstChunk + last.chunks, start);
  }

  /** Return the index that a page is; undefined for an unread one. */
  indexOf(page: Page): Index | undefined {
    return this.indexes.get(page);
  }

  /** Return the row of a known chunk; undefined for a chunk of an unread page. */
  rowOf(chunk: number): number | undefined {
    return this.rowOfChunk.get(chunk);
  }

  /** Return the bounding box of a row: minimum corner, then maximum corner. */
  boxOf(row: number): Float32Array {
    const { boxes, firstRow } = this.listing[row]!;
    return boxes.subarray(6 * (row - firstRow), 6 * (row - firstRow + 1));
  }

  /** Return the number of the parent of a known chunk; −1 for none. */
  parentOf(chunk: number): number {
    return this.chunks[this.parents[this.rowOfChunk.get(chunk)!]!] ?? -1;
  }

  /** Return the number of splats before a chunk; undefined inside an unread page. */
  splatsBefore(chunk: number): number | undefined {
    return this.starts.get(chunk);
  }

  /** Iterate over the rows of chunks and of unread pages, in the order of the file. */
  *inFileOrder(index = this.root): Generator<number, void, undefined> {
    if (index === undefined) return;
    for (let i = 0; i < index.chunkCount; i++) yield index.firstRow + i;
    for (const page of index.pages) {
      const below = this.indexes.get(page);
      if (below === undefined) yield page.row;
      else yield* this.inFileOrder(below);
    }
  }

  private push(index: Index, chunk: number, splats: number, start: number, cell: number): number {
    this.chunks.push(chunk);
    this.listing.push(index);
    this.starts.set(chunk, start);
    this.parents.push(this.parentRow(index, cell));
    return this.splats.push(splats) - 1;
  }

  /** Return the row of the last chunk so far, in an index or above it, whose cell contains a cell. */
  private parentRow(index: Index, cell: number): number {
    for (let above: Index | undefined = index; above !== undefined; above = above.page?.listedBy) {
      const last = this.lastOfCell.get(above)!;
      let parent = -1;
      for (let around = cell; around > 0; around = Math.floor(around / 2)) {
        parent = Math.max(parent, last.get(around) ?? -1);
      }
      if (parent >= 0) return parent;
    }
    return -1;
  }
}
