import { type CompensationLayer, readLayer, type Shifts, shiftsOf } from "../container/compensation.js";
import type { SceneIndex } from "../container/scene_index.js";

/** How splats make up for chunks that are not there (SPEC 5.9, 8.5): the layers that have come, applied to any prefix. */
export class PrefixCompensation {
  private readonly layers: CompensationLayer[] = [];
  /** Payloads that wait for the layers before them, or for the index of their chunks. */
  private readonly waiting = new Map<number, Uint8Array>();

  constructor(private readonly index: SceneIndex) {}

  /** Layers that count for now. */
  get knownLayers(): number {
    return this.layers.length;
  }

  /** Take a layer's segment; its CRC was checked. */
  add(layer: number, payload: Uint8Array): void {
    if (layer >= this.layers.length) this.waiting.set(layer, payload);
    this.read();
  }

  /**
   * What is added to a chunk's log scales and logits while only the first chunks of the file are there.
   *
   * With every chunk more the numbers come closer to those of the next layer, and with the last chunk nothing is
   * added, so that a viewer that asks again as chunks arrive takes the compensation back smoothly.
   *
   * @param prefix - Number of chunks that are there, from the first on.
   * @param chunk - One of them.
   * @returns A number for each splat; undefined where nothing is added.
   */
  shifts(prefix: number, chunk: number): Shifts | undefined {
    this.read();
    const scene = { chunks: this.index.totalChunkCount, splats: this.index.scene.splats };
    return shiftsOf(this.layers, this.index.chunks, scene, prefix, chunk);
  }

  /** Read the layers whose turn it is. */
  private read(): void {
    for (;;) {
      const payload = this.waiting.get(this.layers.length);
      if (payload === undefined) return;
      const layer = readLayer(payload, this.index.chunks, this.index.totalChunkCount, this.layers.at(-1));
      if (layer === undefined) return;
      this.waiting.delete(this.layers.length);
      this.layers.push(layer);
    }
  }
}
