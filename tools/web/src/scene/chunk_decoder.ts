import { readAttributes, type AttributeArray } from "../container/attributes.js";
import type { SceneIndex } from "../container/scene_index.js";
import type { Kernels } from "../kernels/kernels.js";
import { Payload } from "../streams/records.js";
import { addressTable } from "../streams/step_model.js";
import { readHead, type HeadColumns } from "./chunk_head.js";
import { readTail, shnFloats, writeShn, type TailSource } from "./chunk_tail.js";
import { Codebooks } from "./codebooks.js";
import { SH_WORDS, type PackedSplats, type PackRanges } from "./packed_splats.js";
import type { Splats } from "./splats.js";

/** The payloads of one chunk. */
export interface ChunkPayloads {
  readonly chunk: number;
  readonly head: Uint8Array;
  readonly refinement?: Uint8Array | undefined;
  readonly tail?: Uint8Array | undefined;
}

/** What the decoder has to know of the file: a part of its index that can be sent to a worker. */
export type DecoderIndex = Pick<SceneIndex, "scene" | "codebooks">;

/** Decodes the chunks of one scene; codebooks stay in its memory from chunk to chunk. */
export class ChunkDecoder {
  private readonly codebooks: Codebooks;
  private readonly added = new Set<string>();

  /**
   * @param k - Memory and arithmetic, for this scene alone.
   * @param index - What the root says.
   */
  constructor(
    readonly k: Kernels,
    private readonly index: DecoderIndex,
  ) {
    this.codebooks = new Codebooks(k, index.codebooks);
  }

  /** Decode a codebook's segment, once; its CRC was checked. */
  addCodebook(codebook: number, kind: number, payload: Uint8Array): void {
    const key = `${codebook}.${kind}`;
    if (this.added.has(key)) return;
    this.codebooks.add(codebook, kind, payload);
    this.added.add(key);
  }

  /** Whether a codebook's segment was decoded. */
  hasCodebook(codebook: number, kind: number): boolean {
    return this.added.has(`${codebook}.${kind}`);
  }

  /**
   * Decode a chunk and hand its columns to a function; its memory is given back afterwards.
   *
   * @param payloads - The chunk's payloads, whose CRCs were checked.
   * @param rows - Splats of the chunk.
   * @param needs - Codebooks that head and tail need.
   * @param degree - SH degree wanted, at most the scene's.
   */
  withChunk<T>(
    payloads: ChunkPayloads, rows: number, needs: { readonly head: number; readonly tail: number }, degree: number,
    use: (head: HeadColumns, tail: TailSource | undefined) => T,
  ): T {
    const { k, codebooks } = this;
    const mark = k.mark();
    try {
      const head = new Payload(k, payloads.head, rows, "head");
      const refinement = payloads.refinement && new Payload(k, payloads.refinement, rows, "refinement");
      const columns = readHead(k, head, refinement, rows, needs.head, codebooks);
      const tail =
        payloads.tail && degree > 0
          ? readTail(
              k, new Payload(k, payloads.tail, rows, "tail"), needs.tail, codebooks, this.index.scene.shDegree,
              degree,
            )
          : undefined;
      return use(columns, tail);
    } finally {
      k.release(mark);
    }
  }

  /** Decode a chunk to the bit (SPEC 2.3). */
  decode(
    payloads: ChunkPayloads, rows: number, needs: { readonly head: number; readonly tail: number }, degree: number,
  ): Splats {
    return this.withChunk(payloads, rows, needs, degree, (head, tail) => {
      const { k } = this;
      const floats = shnFloats(degree);
      const shN = new Float32Array(rows * floats);
      if (tail !== undefined) {
        const target = k.alloc(4 * rows * floats);
        writeShn(k, tail, rows, degree, target);
        shN.set(k.f32.subarray(target >>> 2, (target >>> 2) + rows * floats));
      }
      return {
        count: rows,
        shDegree: degree,
        means: this.rows(head.means, rows),
        scales: this.rows(head.scales, rows),
        quats: this.rows(head.quats, rows),
        opacities: this.rows([head.opacities], rows),
        sh0: this.rows(head.sh0, rows),
        shN,
      };
    });
  }

  /**
   * Decode a chunk into what a renderer uploads (SPEC 8.6).
   *
   * @param ranges - What the codes stand for.
   */
  decodePacked(
    payloads: ChunkPayloads, rows: number, needs: { readonly head: number; readonly tail: number }, degree: number,
    ranges: PackRanges,
  ): PackedSplats {
    return this.withChunk(payloads, rows, needs, degree, (head, tail) => {
      const { k } = this;
      const columns = [...head.means, ...head.scales, ...head.quats, head.opacities, ...head.sh0];
      const splats = k.alloc(16 * rows);
      k.packSplats(addressTable(k, columns), rows, ranges.rgbMin, ranges.rgbMax, splats);
      const bands = SH_WORDS.slice(0, degree).map((words) => ({ words: words * rows, address: k.alloc(4 * words * rows) }));
      if (tail !== undefined) {
        const shN = k.alloc(4 * rows * shnFloats(degree));
        writeShn(k, tail, rows, degree, shN);
        const [sh1, sh2, sh3] = [0, 1, 2].map((band) => bands[band]?.address ?? 0) as [number, number, number];
        k.packShn(shN, rows, degree, ranges.shRange, sh1, sh2, sh3);
      }
      return {
        count: rows,
        words: k.u32.slice(splats >>> 2, (splats >>> 2) + 4 * rows),
        sh: bands.map(({ words, address }) => {
          return tail === undefined ? new Uint32Array(words) : k.u32.slice(address >>> 2, (address >>> 2) + words);
        }),
        ranges,
      };
    });
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
