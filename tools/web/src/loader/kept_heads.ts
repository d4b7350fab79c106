import type { BandArray, DecodedChunk } from "../workers/decode_task.js";

/**
 * Decoded heads, kept until their tails arrive and can be decoded alone.
 *
 * Heads are kept in the order of arrival up to a limit; the others are decoded again with their tails.
 */
export class KeptHeads {
  private readonly heads = new Map<number, DecodedChunk>();
  private limit = 0;
  /** Bytes of all kept heads. */
  bytes = 0;

  /** Set the limit, bytes; the latest heads, whose tails arrive last, are dropped first. */
  keepAtMost(bytes: number): void {
    this.limit = bytes;
    for (const chunk of [...this.heads.keys()].reverse()) {
      if (this.bytes <= bytes) return;
      this.remove(chunk);
    }
  }

  /** Keep a copy of a chunk without its coefficients above DC, if there is room. */
  keep(chunk: number, decoded: DecodedChunk): void {
    this.remove(chunk);
    if (this.bytes + headBytes(decoded) > this.limit) return;
    this.heads.set(chunk, copyHead(decoded));
    this.bytes += headBytes(decoded);
  }

  /** Remove and return the head of a chunk. */
  remove(chunk: number): DecodedChunk | undefined {
    const head = this.heads.get(chunk);
    if (head === undefined) return undefined;
    this.heads.delete(chunk);
    this.bytes -= headBytes(head);
    return head;
  }
}

/** Combine a kept head and its decoded bands. */
export function withBands({ splats, packed }: DecodedChunk, bands: readonly BandArray[]): DecodedChunk {
  return {
    ...(splats && { splats: { ...splats, shN: bands[0] as Float32Array } }),
    ...(packed && { packed: { ...packed, sh: bands as readonly Uint32Array[] } }),
  };
}

function copyHead({ splats, packed }: DecodedChunk): DecodedChunk {
  return {
    ...(splats && {
      splats: {
        ...splats,
        means: splats.means.slice(),
        scales: splats.scales.slice(),
        quats: splats.quats.slice(),
        opacities: splats.opacities.slice(),
        sh0: splats.sh0.slice(),
        shN: new Float32Array(0),
      },
    }),
    ...(packed && { packed: { ...packed, words: packed.words.slice(), means: packed.means.slice(), sh: [] } }),
  };
}

function headBytes({ splats, packed }: DecodedChunk): number {
  const arrays = [
    ...(splats ? [splats.means, splats.scales, splats.quats, splats.opacities, splats.sh0] : []),
    ...(packed ? [packed.words, packed.means] : []),
  ];
  return arrays.reduce((sum, array) => sum + array.byteLength, 0);
}
