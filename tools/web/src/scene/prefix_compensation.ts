import { type SetState, setStates } from "../container/chunk_sets.js";
import { type CompensationLayer, readLayer, type Shifts, shiftsOf } from "../container/compensation.js";
import type { SceneIndex } from "../container/scene_index.js";

/** Compensation for missing chunks (SPEC 5.9, 8.5): the layers received so far, for any prefix. */
export class PrefixCompensation {
  private readonly layers: CompensationLayer[] = [];
  /** Payloads whose previous layer, or a page of whose chunks, is still missing. */
  private readonly waiting = new Map<number, Uint8Array>();

  /** States of the chunks of the last prefix asked for, and what they follow from. */
  private ofPrefix: { readonly known: string; readonly states: readonly SetState[] } | undefined;

  constructor(private readonly index: SceneIndex) {}

  /** Number of chunks of the last layer in use; 0 for none. */
  get layerChunks(): number {
    this.read();
    return this.layers.at(-1)?.chunks ?? 0;
  }

  /** Add the segment of a layer, whose CRC was checked. */
  add(layer: number, payload: Uint8Array): void {
    if (layer >= this.layers.length) this.waiting.set(layer, payload);
    this.read();
  }

  /**
   * Return the shifts of a chunk's log scales and logits while a prefix of the file, or a set of chunks, is present.
   *
   * The shifts change gradually with every chunk that arrives and are zero for the whole file, so a viewer that
   * evaluates them again after each chunk shows no jump.
   *
   * @param prefix - Number of chunks of the prefix.
   * @param chunk - Number of a chunk in the prefix.
   * @param share - For a chunk in a set, what {@link setStates} says beside the prefix.
   * @returns undefined if the chunk is not compensated.
   */
  shifts(prefix: number, chunk: number, share = this.shareInPrefix(prefix, chunk)): Shifts | undefined {
    this.read();
    return shiftsOf(this.layers, this.index.rows, this.index.totalChunkCount, prefix, chunk, share);
  }

  /** Return `SetState.share` of a chunk in a prefix of a scene that is cut into cells. */
  private shareInPrefix(prefix: number, chunk: number): number | undefined {
    const { rows } = this.index;
    const { layerChunks } = this;
    if (!rows.isCut || prefix <= layerChunks) return undefined;
    const known = `${prefix} ${layerChunks} ${rows.count}`;
    if (this.ofPrefix?.known !== known) {
      const chunks = Array.from({ length: prefix }, (_, i) => i);
      this.ofPrefix = { known, states: setStates(chunks, rows, layerChunks) };
    }
    return this.ofPrefix.states[chunk]!.share;
  }

  /** Read the layers whose predecessors are known. */
  private read(): void {
    for (;;) {
      const payload = this.waiting.get(this.layers.length);
      if (payload === undefined) return;
      const chunks = { known: this.index.chunkCount, all: this.index.totalChunkCount };
      const layer = readLayer(payload, this.index.rows, chunks, this.layers.at(-1));
      if (layer === undefined) return;
      this.waiting.delete(this.layers.length);
      this.layers.push(layer);
    }
  }
}
