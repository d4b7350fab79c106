/**
 * Return the parent of each chunk: the chunk that it adds detail to (SPEC 5.4).
 *
 * @param cells - Cell number of each chunk, 0 where chunks are not cut by cell.
 * @returns Chunk number of each parent; -1 for a chunk without one.
 */
export function parentsOf(cells: ArrayLike<number>): Int32Array {
  const last = new Map<number, number>();
  return Int32Array.from(cells, (cell, chunk) => {
    let parent = -1;
    for (let around = cell; around > 0; around = Math.floor(around / 2))
      parent = Math.max(parent, last.get(around) ?? -1);
    last.set(cell, chunk);
    return parent;
  });
}

/**
 * Return whether a set of chunks contains the parent of each of its chunks.
 *
 * @param chunks - Chunk numbers, ascending.
 */
export function isClosed(chunks: readonly number[], parents: Int32Array): boolean {
  const held = new Set(chunks);
  return chunks.every((chunk) => parents[chunk]! < 0 || held.has(parents[chunk]!));
}

/**
 * Return the equivalent prefix of each chunk of a set, for its compensation (SPEC 8.5).
 *
 * The equivalent prefix is the longest prefix, up to the last chunk of the set, in which the chunk and its descendants
 * have no more splats than in the set.
 *
 * @param chunks - Chunk numbers, ascending, each with its parent in the set.
 * @param parents - Parent of each chunk of the file, from {@link parentsOf}.
 * @param splats - Number of splats of each chunk of the file.
 * @returns Number of chunks of the prefix, for each chunk of the set.
 */
export function equivalentPrefixes(
  chunks: readonly number[],
  parents: Int32Array,
  splats: ArrayLike<number>,
): number[] {
  const end = chunks.length === 0 ? 0 : chunks[chunks.length - 1]! + 1;
  const held = new Float64Array(end);
  for (const chunk of chunks) {
    for (let above = chunk; above >= 0; above = parents[above]!) held[above]! += splats[chunk]!;
  }
  const passed = new Float64Array(end);
  const found = new Array<number>(end).fill(end);
  for (let chunk = 0; chunk < end; chunk++) {
    for (let above = chunk; above >= 0; above = parents[above]!) {
      passed[above]! += splats[chunk]!;
      if (passed[above]! > held[above]! && found[above] === end) found[above] = chunk;
    }
  }
  return chunks.map((chunk) => found[chunk]!);
}
