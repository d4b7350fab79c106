/**
 * The chunk that each chunk adds detail to (SPEC 5.4).
 *
 * @param cells - Number of each chunk's cell, 0 where chunks are not cut by cell.
 * @returns A number for each chunk; -1 where it has no parent.
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

/** Whether a set of chunks, ascending, holds with each chunk its parent. */
export function isClosed(chunks: readonly number[], parents: Int32Array): boolean {
  const held = new Set(chunks);
  return chunks.every((chunk) => parents[chunk]! < 0 || held.has(parents[chunk]!));
}

/**
 * The prefix that each chunk of a set is compensated as (SPEC 8.5): the longest, up to the last chunk of the set, in
 * which the chunk and its descendants have no more splats than in the set.
 *
 * @param chunks - Numbers of the set, ascending, with each chunk its parent.
 * @param parents - Of each chunk of the file, as {@link parentsOf} gives them.
 * @param splats - Of each chunk of the file.
 * @returns For each chunk of the set the chunks of its prefix.
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
