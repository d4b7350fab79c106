import type { Shifts } from "../container/compensation.js";
import type { ChunkUpdate } from "../loader/stream_options.js";
import { SH_WORDS, shiftPacked } from "../scene/packed_splats.js";

/** Splats of a line of the textures of packed splats. */
const TEXTURE_WIDTH = 2048;

/** Packed splats of a whole scene, in whole lines of textures; rows of zeros are not drawn. */
export class PackedRows {
  /** Four words per row. */
  readonly words: Uint32Array<ArrayBuffer>;
  /** Bands from 1 to the degree. */
  readonly bands: readonly Uint32Array<ArrayBuffer>[];
  /** Lines of the textures. */
  readonly lines: number;

  constructor(splats: number, degree: number) {
    this.lines = Math.max(1, Math.ceil(splats / TEXTURE_WIDTH));
    const rows = this.lines * TEXTURE_WIDTH;
    this.words = new Uint32Array(4 * rows);
    this.bands = SH_WORDS.slice(0, degree).map((words) => new Uint32Array(words * rows));
  }

  /** Write a chunk's rows, with their shifts of compensation (SPEC 8.5). */
  write({ firstRow, packed }: ChunkUpdate, shifts: Shifts | undefined): void {
    if (shifts === undefined) this.words.set(packed!.words, 4 * firstRow);
    else shiftPacked(packed!.words, shifts, this.words, 4 * firstRow);
    packed!.sh.slice(0, this.bands.length).forEach((band, i) => {
      this.bands[i]!.set(band, SH_WORDS[i]! * firstRow);
    });
  }
}
