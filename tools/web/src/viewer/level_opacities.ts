/** Opacities of one chunk's splats, level by level from the first that draws it. */
interface ChunkOpacities {
  readonly first: number;
  /** The last level that draws the chunk. */
  readonly last: number;
  /** In 1/255; what has not come is undefined, but for the first. */
  readonly known: readonly (Uint8Array | undefined)[];
  readonly count: number;
}

/** The opacities of a scene's splats at its levels (SPEC 5.11), and those of two adjacent levels as shaders mix them. */
export class LevelOpacities {
  private readonly chunks = new Map<number, ChunkOpacities>();

  /**
   * Note what has come of a chunk.
   *
   * @param drawnBy - Levels that draw the chunk, in their order; none for a chunk that is there for the first seconds alone.
   * @param opacities - Level by level from the first of these on.
   */
  put(chunk: number, drawnBy: readonly number[], opacities: readonly (Uint8Array | undefined)[]): void {
    const [first, last] = drawnBy.length === 0 ? [0, Infinity] : [drawnBy[0]!, drawnBy.at(-1)!];
    this.chunks.set(chunk, { first, last, known: opacities, count: opacities[0]!.length });
  }

  /** Forget all chunks. */
  clear(): void {
    this.chunks.clear();
  }

  /** The chunks of which something has come. */
  get known(): Iterable<number> {
    return this.chunks.keys();
  }

  /**
   * A word for each splat of a chunk: its opacity at a level in the lowest byte, at the next level in the byte above, in 1/255.
   *
   * @param factor - What opacities are multiplied by, 0 to 1.
   */
  words(chunk: number, level: number, factor = 1): Uint32Array {
    const entry = this.chunks.get(chunk)!;
    const [lower, upper] = [at(entry, level), at(entry, level + 1)];
    const words = new Uint32Array(entry.count);
    for (let i = 0; i < words.length; i++) {
      words[i] = Math.round((lower?.[i] ?? 0) * factor) | (Math.round((upper?.[i] ?? 0) * factor) << 8);
    }
    return words;
  }
}

/** Opacities at a level: those of the level before where there are none; undefined where the level does not draw the chunk. */
function at({ first, last, known }: ChunkOpacities, level: number): Uint8Array | undefined {
  if (level < first || level > last) return undefined;
  return known
    .slice(0, level - first + 1)
    .filter((values) => values !== undefined)
    .at(-1);
}
