import type { ReasonCode } from "../errors.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import type { DecodedChunk, DecodeTask } from "./decode_task.js";

/** Message to a worker. */
export type Request =
  | { readonly type: "scene"; readonly index: DecoderIndex }
  | { readonly type: "codebook"; readonly codebook: number; readonly kind: number; readonly payload: Uint8Array }
  | { readonly type: "chunk"; readonly id: number; readonly task: DecodeTask };

/** Message of a worker: its start, then a decoded chunk or an error for each task. */
export type Response =
  | { readonly ready: true }
  | { readonly id: number; readonly decoded: DecodedChunk }
  | {
      readonly id: number;
      readonly code: ReasonCode | undefined;
      readonly message: string;
      readonly offset: number | undefined;
    };

function isPresent<T>(value: T | undefined): value is T {
  return value !== undefined;
}

/** Return the buffers of a decoded chunk, to be transferred instead of copied. */
export function buffersOf({ splats, packed, bands }: DecodedChunk): ArrayBuffer[] {
  const arrays = [
    ...(splats ? [splats.means, splats.scales, splats.quats, splats.opacities, splats.sh0, splats.shN] : []),
    ...(packed ? [packed.words, packed.means, ...packed.sh, ...(packed.opacities ?? []).filter(isPresent)] : []),
    ...(bands ?? []),
  ];
  return arrays.map((array) => array.buffer as ArrayBuffer);
}
