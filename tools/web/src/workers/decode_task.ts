import type { KernelsMaker } from "../kernels/load.js";
import { ChunkDecoder, type ChunkPayloads, type DecoderIndex, type TailPayload } from "../scene/chunk_decoder.js";
import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";
import type { Splats } from "../scene/splats.js";

/** Format of decoded chunks: exact arrays, or 16 bytes per splat, exact means and packed bands. */
export type ChunkFormat = "splats" | "packed";

/** One chunk to decode, in a form that can be sent to a worker. */
export interface DecodeTask {
  /** Payloads; without a head the bands alone are decoded. */
  readonly payloads: ChunkPayloads | TailPayload;
  readonly rows: number;
  readonly needs: { readonly head: number; readonly tail: number };
  readonly degree: number;
  readonly format: ChunkFormat;
  /** Value ranges of the codes of packed chunks. */
  readonly ranges: PackRanges;
}

/** Coefficients above DC: all of `splats`, or one band of `packed`. */
export type BandArray = Float32Array | Uint32Array;

/** A decoded chunk: one of the three fields, by the format of the task. */
export interface DecodedChunk {
  readonly splats?: Splats;
  readonly packed?: PackedSplats;
  /** Result of a task without a head: `shN`, or the packed bands. */
  readonly bands?: readonly BandArray[];
}

/** Decoder of the chunks of one scene, on this thread or in workers. */
export interface ChunkService {
  /** Add a codebook's segment, before the first chunk that needs it. */
  addCodebook(codebook: number, kind: number, payload: Uint8Array): void;
  decode(task: DecodeTask): Promise<DecodedChunk>;
  close(): void;
}

/** Decoder on the caller's thread. */
export class InlineService implements ChunkService {
  private readonly decoder: ChunkDecoder;

  constructor(index: DecoderIndex, kernels: KernelsMaker) {
    this.decoder = new ChunkDecoder(kernels(), index);
  }

  addCodebook(codebook: number, kind: number, payload: Uint8Array): void {
    this.decoder.addCodebook(codebook, kind, payload);
  }

  async decode(task: DecodeTask): Promise<DecodedChunk> {
    return this.decodeNow(task);
  }

  /** Decode at once, as in a worker. */
  decodeNow({ payloads, rows, needs, degree, format, ranges }: DecodeTask): DecodedChunk {
    if (payloads.head === undefined) {
      if (format === "packed")
        return { bands: this.decoder.decodePackedBands(payloads, rows, needs.tail, degree, ranges) };
      return { bands: [this.decoder.decodeShN(payloads, rows, needs.tail, degree)] };
    }
    if (format === "packed") return { packed: this.decoder.decodePacked(payloads, rows, needs, degree, ranges) };
    return { splats: this.decoder.decode(payloads, rows, needs, degree) };
  }

  close(): void {
    // The memory is freed with this object.
  }
}

/** Decoder on the caller's thread with one task per chunk, so that a page without workers stays responsive. */
export class SlicedService extends InlineService {
  private last: Promise<unknown> = Promise.resolve();

  override async decode(task: DecodeTask): Promise<DecodedChunk> {
    const turn = this.last.then(() => new Promise((resolve) => setTimeout(resolve, 0)));
    this.last = turn;
    await turn;
    return this.decodeNow(task);
  }
}
