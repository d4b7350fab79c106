/** Opacities of one chunk's splats per level, from the first that draws it. */
interface ChunkOpacities {
  readonly first: number;
  /** Last level that draws the chunk. */
  readonly last: number;
  /** Opacities in 1/255; all but the first may still be undefined. */
  readonly known: readonly (Uint8Array | undefined)[];
  readonly count: number;
}

/** Opacities of a scene's splats at its levels (SPEC 5.11), combined for shaders that mix two adjacent levels. */
export class LevelOpacities {
  private readonly chunks = new Map<number, ChunkOpacities>();

  /**
   * Set the opacities received of a chunk.
   *
   * @param drawnBy - Levels that draw the chunk, ascending; empty for a chunk for the first seconds alone.
   * @param opacities - Opacities per level, from the first of `drawnBy`.
   */
  put(chunk: number, drawnBy: readonly number[], opacities: readonly (Uint8Array | undefined)[]): void {
    const [first, last] = drawnBy.length === 0 ? [0, Infinity] : [drawnBy[0]!, drawnBy.at(-1)!];
    this.chunks.set(chunk, { first, last, known: opacities, count: opacities[0]!.length });
  }

  /** Remove all chunks. */
  clear(): void {
    this.chunks.clear();
  }

  /** Chunks with opacities. */
  get known(): Iterable<number> {
    return this.chunks.keys();
  }

  /**
   * Return one word per splat of a chunk: its opacity at a level in the lowest byte, at the next level in the byte
   * above.
   *
   * @param factor - Factor of the opacities, 0 to 1.
   */
  words(chunk: number, level: number, factor = 1): Uint32Array {
    const entry = this.chunks.get(chunk)!;
    const [lower, upper] = [opacitiesAt(entry, level), opacitiesAt(entry, level + 1)];
    const words = new Uint32Array(entry.count);
    for (let i = 0; i < words.length; i++) {
      words[i] = Math.round((lower?.[i] ?? 0) * factor) | (Math.round((upper?.[i] ?? 0) * factor) << 8);
    }
    return words;
  }
}

/** Return the opacities at a level, or at the previous one that has any; undefined where the level omits the chunk. */
function opacitiesAt({ first, last, known }: ChunkOpacities, level: number): Uint8Array | undefined {
  if (level < first || level > last) return undefined;
  return known
    .slice(0, level - first + 1)
    .filter((values) => values !== undefined)
    .at(-1);
}
