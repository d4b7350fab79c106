import { type AttributeArray, readAttributes } from "../container/attributes.js";
import type { SceneIndex } from "../container/scene_index.js";
import type { Kernels } from "../kernels/kernels.js";
import { Payload } from "../streams/records.js";
import { addressTable } from "../streams/step_model.js";
import { type HeadColumns, readHead, readOpacities } from "./chunk_head.js";
import { readTail, shnFloats, type TailSource, writeShn } from "./chunk_tail.js";
import { Codebooks } from "./codebooks.js";
import { type PackedSplats, type PackRanges, packedOpacities, SH_WORDS } from "./packed_splats.js";
import type { Splats } from "./splats.js";

/** Payloads of one chunk. */
export interface ChunkPayloads {
  readonly chunk: number;
  readonly head: Uint8Array;
  readonly refinement?: Uint8Array | undefined;
  /** Opacities of later levels, in the order of the levels; the last one present applies. */
  readonly opacities?: readonly (Uint8Array | undefined)[] | undefined;
  readonly tail?: Uint8Array | undefined;
}

/** Tail of a chunk whose head was decoded before. */
export interface TailPayload {
  readonly chunk: number;
  readonly head?: undefined;
  readonly tail: Uint8Array;
}

/** Part of an index that decoding needs; it can be sent to a worker. */
export type DecoderIndex = Pick<SceneIndex, "scene" | "codebooks">;

/** Decoder of the chunks of one scene; decoded codebooks stay in its memory. */
export class ChunkDecoder {
  private readonly codebooks: Codebooks;
  private readonly added = new Set<string>();

  /**
   * @param k - Kernels of this decoder alone.
   * @param index - Scene and codebooks of the root.
   */
  constructor(
    readonly k: Kernels,
    private readonly index: DecoderIndex,
  ) {
    this.codebooks = new Codebooks(k, index.codebooks);
  }

  /** Decode the segment of a codebook, whose CRC was checked, unless it was decoded before. */
  addCodebook(codebook: number, kind: number, payload: Uint8Array): void {
    const key = `${codebook}.${kind}`;
    if (this.added.has(key)) return;
    this.codebooks.add(codebook, kind, payload);
    this.added.add(key);
  }

  /** Return whether the segment of a codebook was decoded. */
  hasCodebook(codebook: number, kind: number): boolean {
    return this.added.has(`${codebook}.${kind}`);
  }

  /**
   * Decode a chunk, pass its columns to a function, and release their memory afterwards.
   *
   * @param payloads - Payloads of the chunk, whose CRCs were checked.
   * @param rows - Splats of the chunk.
   * @param needs - Codebooks that head and tail need, as bit sets.
   * @param degree - SH degree to decode, at most that of the scene.
   * @param use - Receives addresses: of the head's columns, of the tail, and of opacities per level, the head's first.
   */
  withChunk<T>(
    payloads: ChunkPayloads,
    rows: number,
    needs: { readonly head: number; readonly tail: number },
    degree: number,
    use: (head: HeadColumns, tail: TailSource | undefined, opacities: readonly (number | undefined)[]) => T,
  ): T {
    const { k, codebooks } = this;
    const mark = k.mark();
    try {
      const head = new Payload(k, payloads.head, rows, "head");
      const refinement = payloads.refinement && new Payload(k, payloads.refinement, rows, "refinement");
      const first = readHead(k, head, refinement, rows, needs.head, codebooks);
      const tail = payloads.tail && degree > 0 ? this.tailOf(payloads.tail, rows, needs.tail, degree) : undefined;
      const opacities = [
        first.opacities,
        ...(payloads.opacities ?? []).map((payload) => payload && this.laterOpacities(payload, first, rows)),
      ];
      const last = opacities.filter((address) => address !== undefined).at(-1)!;
      return use({ ...first, opacities: last }, tail, opacities);
    } finally {
      k.release(mark);
    }
  }

  /** Decode the opacities of a later level into a new column; return its address. */
  private laterOpacities(payload: Uint8Array, head: HeadColumns, rows: number): number {
    const { k } = this;
    const before = k.alloc(4 * rows);
    k.f32.copyWithin(before >>> 2, head.opacities >>> 2, (head.opacities >>> 2) + rows);
    return readOpacities(k, new Payload(k, payload, rows, "opacities"), before, rows);
  }

  /** Decode a tail, pass it to a function, and release its memory afterwards. */
  private withTail<T>(
    { tail }: TailPayload,
    rows: number,
    needs: number,
    degree: number,
    use: (tail: TailSource) => T,
  ): T {
    const mark = this.k.mark();
    try {
      return use(this.tailOf(tail, rows, needs, degree));
    } finally {
      this.k.release(mark);
    }
  }

  private tailOf(payload: Uint8Array, rows: number, needs: number, degree: number): TailSource {
    const { k, codebooks, index } = this;
    return readTail(k, new Payload(k, payload, rows, "tail"), needs, codebooks, index.scene.shDegree, degree);
  }

  /** Decode a chunk, exact to the bit (SPEC 2.3). */
  decode(
    payloads: ChunkPayloads,
    rows: number,
    needs: { readonly head: number; readonly tail: number },
    degree: number,
  ): Splats {
    return this.withChunk(payloads, rows, needs, degree, (head, tail) => {
      return {
        count: rows,
        shDegree: degree,
        means: this.rows(head.means, rows),
        scales: this.rows(head.scales, rows),
        quats: this.rows(head.quats, rows),
        opacities: this.rows([head.opacities], rows),
        sh0: this.rows(head.sh0, rows),
        shN: tail === undefined ? new Float32Array(rows * shnFloats(degree)) : this.shN(tail, rows, degree),
      };
    });
  }

  /**
   * Decode the coefficients above DC of a chunk, exact to the bit.
   *
   * @param payload - Tail, whose CRC was checked.
   * @param rows - Splats of the chunk.
   * @param needs - Codebooks that the tail needs, as a bit set.
   * @param degree - SH degree to decode, above 0 and at most that of the scene.
   * @returns 3·((degree + 1)² − 1) values per row.
   */
  decodeShN(payload: TailPayload, rows: number, needs: number, degree: number): Float32Array {
    return this.withTail(payload, rows, needs, degree, (tail) => this.shN(tail, rows, degree));
  }

  /**
   * Decode a chunk to packed splats for a renderer (SPEC 8.6).
   *
   * @param ranges - Value ranges of the packed codes.
   */
  decodePacked(
    payloads: ChunkPayloads,
    rows: number,
    needs: { readonly head: number; readonly tail: number },
    degree: number,
    ranges: PackRanges,
  ): PackedSplats {
    return this.withChunk(payloads, rows, needs, degree, (head, tail, opacities) => {
      const { k } = this;
      const columns = [...head.means, ...head.scales, ...head.quats, head.opacities, ...head.sh0];
      const splats = k.alloc(16 * rows);
      k.packSplats(addressTable(k, columns), rows, ranges.rgbMin, ranges.rgbMax, splats);
      return {
        count: rows,
        words: k.u32.slice(splats >>> 2, (splats >>> 2) + 4 * rows),
        means: this.rows(head.means, rows),
        sh:
          tail === undefined
            ? SH_WORDS.slice(0, degree).map((words) => new Uint32Array(words * rows))
            : this.packedBands(tail, rows, degree, ranges),
        ranges,
        ...(payloads.opacities && {
          opacities: opacities.map((address) =>
            address === undefined ? undefined : packedOpacities(k.f32.subarray(address >>> 2, (address >>> 2) + rows)),
          ),
        }),
      };
    });
  }

  /** Decode the packed SH bands of a chunk (SPEC 8.6), with the parameters of `decodeShN` and `decodePacked`. */
  decodePackedBands(
    payload: TailPayload,
    rows: number,
    needs: number,
    degree: number,
    ranges: PackRanges,
  ): Uint32Array[] {
    return this.withTail(payload, rows, needs, degree, (tail) => this.packedBands(tail, rows, degree, ranges));
  }

  /** Decode a chunk's extra attributes (SPEC 5.7). */
  attributes(payload: Uint8Array, rows: number): Map<string, AttributeArray> {
    const mark = this.k.mark();
    try {
      return readAttributes(this.k, payload, this.index.scene.attributes, rows);
    } finally {
      this.k.release(mark);
    }
  }

  private shN(tail: TailSource, rows: number, degree: number): Float32Array {
    const { k } = this;
    const floats = rows * shnFloats(degree);
    const target = k.alloc(4 * floats);
    writeShn(k, tail, rows, degree, target);
    return k.f32.slice(target >>> 2, (target >>> 2) + floats);
  }

  private packedBands(tail: TailSource, rows: number, degree: number, { shRange }: PackRanges): Uint32Array[] {
    const { k } = this;
    const bands = SH_WORDS.slice(0, degree).map((words) => ({
      words: words * rows,
      address: k.alloc(4 * words * rows),
    }));
    const shN = k.alloc(4 * rows * shnFloats(degree));
    writeShn(k, tail, rows, degree, shN);
    const [sh1, sh2, sh3] = [0, 1, 2].map((band) => bands[band]?.address ?? 0) as [number, number, number];
    k.packShn(shN, rows, degree, shRange, sh1, sh2, sh3);
    return bands.map(({ words, address }) => k.u32.slice(address >>> 2, (address >>> 2) + words));
  }

  private rows(columns: readonly number[], rows: number): Float32Array {
    const { k } = this;
    const mark = k.mark();
    const target = k.alloc(4 * rows * columns.length);
    k.interleave(addressTable(k, columns), columns.length, rows, target);
    const values = k.f32.slice(target >>> 2, (target >>> 2) + rows * columns.length);
    k.release(mark);
    return values;
  }
}
