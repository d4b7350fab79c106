import type { CogsplatError, SourceError } from "../errors.js";
import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";
import type { Splats } from "../scene/splats.js";
import type { ChunkFormat } from "../workers/decode_task.js";

/** A chunk's entry in the index, from which priorities are computed. */
export interface ChunkInfo {
  readonly chunk: number;
  readonly splats: number;
  /**
   * Bounding box of its splats' extents, scene units, relative to the scene's origin: minimum corner, then maximum
   * corner.
   */
  readonly box: Float32Array;
  /** Sum of its splats' contributions; 0 for a scene without contributions. */
  readonly contribution: number;
  readonly layer: number;
  readonly cell: number;
  readonly object: number;
  /**
   * Number of chunks of the first prefix that no longer draws the chunk; 0 for a chunk that all prefixes draw (SPEC
   * 5.10).
   */
  readonly until: number;
}

/** Contents, order and limits of a stream. */
export interface StreamOptions {
  /** Stops the stream: requests are aborted and memory is released. */
  readonly signal?: AbortSignal;
  /** Return the priority of a chunk: higher ones come first, negative ones are excluded. File order by default. */
  readonly priority?: (chunk: ChunkInfo) => number;
  /** SH degree to decode; by default that of the scene. */
  readonly degree?: number;
  /**
   * `splats`: arrays exact to the bit. `packed`: 16 bytes per splat, exact means and packed bands. `spark`, `playcanvas`: their
   * textures.
   */
  readonly format?: ChunkFormat;
  /** Value ranges of the codes of packed chunks. */
  readonly ranges?: Partial<PackRanges>;
  /**
   * Bytes of rows at most; chunks beyond are not fetched. The rest of the budget may hold decoded heads until their
   * tails arrive.
   */
  readonly memoryBudget?: number;
  /** Splats at most; chunks beyond are not fetched. */
  readonly splatBudget?: number;
  /** Whether to fetch the layers of compensation, for `StreamedScene.compensation`. */
  readonly compensate?: boolean;
  /**
   * Level to decode, 0 the coarsest (SPEC 5.11): chunks that it does not draw are not fetched. By default the finest.
   */
  readonly level?: number;
  /**
   * Whether to stream chunks that end (SPEC 5.10); the caller stops drawing each when `ChunkUpdate.prefix` reaches its
   * `until`. By default they are excluded.
   */
  readonly ending?: boolean;
  /**
   * Called with each segment that cannot be fetched and the chunk that lacks it; without it the error ends the stream.
   */
  readonly onDamage?: (error: CogsplatError | SourceError, chunk: number | undefined) => void;
}

/** Rows of one chunk. A later update of the same chunk replaces the rows of the earlier one. */
export interface ChunkUpdate {
  readonly chunk: number;
  /** Row of the whole scene of the chunk's first row. */
  readonly firstRow: number;
  readonly count: number;
  /** Number of chunks of the longest prefix of the file streamed so far, including this chunk. */
  readonly prefix: number;
  /** Whether the coefficients above DC are included. */
  readonly tail: boolean;
  /** Whether the refinement is included. */
  readonly refined: boolean;
  /** Present in the format `splats`. */
  readonly splats?: Splats;
  /** Present in the format `packed`. */
  readonly packed?: PackedSplats;
}

/** Return the bytes of a decoded splat in memory. */
export function bytesPerSplat(format: ChunkFormat, degree: number): number {
  if (format === "packed") return 28 + [0, 8, 24, 40][degree]!;
  return 56 + 12 * ((degree + 1) ** 2 - 1);
}
