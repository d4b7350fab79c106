import type { CogsplatError, SourceError } from "../errors.js";
import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";
import type { Splats } from "../scene/splats.js";
import type { Texels } from "../scene/texel_layouts.js";
import { texelWidths } from "../scene/texels.js";
import type { ChunkFormat } from "../workers/decode_task.js";

/** What is known of a chunk before its bytes come: enough to decide what to fetch first. */
export interface ChunkInfo {
  readonly chunk: number;
  readonly splats: number;
  /** Minimum then maximum corner of what its splats reach, scene units, relative to the scene's origin. */
  readonly box: Float32Array;
  /** Sum of its splats' contributions; 0 where the scene was not scored. */
  readonly contribution: number;
  readonly layer: number;
  readonly cell: number;
  readonly object: number;
  /** The chunk is drawn in prefixes of fewer chunks than this; 0 in all (SPEC 5.10). */
  readonly until: number;
}

/** What a stream gives, and in which order. */
export interface StreamOptions {
  /** Ends the stream: requests are aborted and memory is given back. */
  readonly signal?: AbortSignal;
  /** Chunks with larger numbers come first; a number below 0 leaves a chunk out. File order by default. */
  readonly priority?: (chunk: ChunkInfo) => number;
  /** SH degree wanted; by default the scene's. */
  readonly degree?: number;
  /** `splats`: arrays to the bit. `packed`: 16 bytes a splat and packed bands. `spark`, `playcanvas`: their textures. */
  readonly format?: ChunkFormat;
  /** What the codes of packed chunks stand for. */
  readonly ranges?: Partial<PackRanges>;
  /**
   * Most bytes of rows that are given out; chunks beyond are not fetched. What they leave may hold decoded heads until
   * their tails come.
   */
  readonly memoryBudget?: number;
  /** Most splats that are given out; chunks beyond are not fetched. */
  readonly splatBudget?: number;
  /** Fetch the layers of compensation too, for `StreamedScene.compensation`. */
  readonly compensate?: boolean;
  /** Level wanted, 0 the coarsest (SPEC 5.11): what it does not draw is not fetched. By default the finest. */
  readonly level?: number;
  /**
   * Give chunks that end too (SPEC 5.10); the caller then stops drawing each when `ChunkUpdate.prefix` has come to its
   * `until`. By default they are left out.
   */
  readonly ending?: boolean;
  /** Told of what cannot be had, and of which chunk it is; what is there is drawn without it. */
  readonly onDamage?: (error: CogsplatError | SourceError, chunk: number | undefined) => void;
}

/** Rows of one chunk. A later update of the same chunk replaces the rows of the earlier one. */
export interface ChunkUpdate {
  readonly chunk: number;
  /** Row of the whole scene that the chunk's first row is. */
  readonly firstRow: number;
  readonly count: number;
  /** Chunks that have been given from the first of the file on, without gaps, this one counted. */
  readonly prefix: number;
  /** Whether the coefficients above DC are in it. */
  readonly tail: boolean;
  /** Whether the refinement is in it. */
  readonly refined: boolean;
  /** There where the stream's format is `splats`. */
  readonly splats?: Splats;
  /** There where the stream's format is `packed`. */
  readonly packed?: PackedSplats;
  /** There where the stream's format is that of a renderer's textures. */
  readonly texels?: Texels;
}

/** Bytes that a splat takes in memory as it is given out. */
export function bytesPerSplat(format: ChunkFormat, degree: number): number {
  if (format === "packed") return 16 + [0, 8, 24, 40][degree]!;
  if (format !== "splats") return texelWidths(format, degree).reduce((sum, { width, bytes }) => sum + width * bytes, 0);
  return 56 + 12 * ((degree + 1) ** 2 - 1);
}
