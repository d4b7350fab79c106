import type { SceneRows } from "./scene_rows.js";

/**
 * Return whether a set of chunks contains the parent of each of its chunks (SPEC 5.4).
 *
 * @param chunks - Numbers of known chunks, ascending.
 */
export function isClosed(chunks: readonly number[], rows: SceneRows): boolean {
  const held = new Set(chunks);
  return chunks.every((chunk) => {
    const parent = rows.parentOf(chunk);
    return parent < 0 || held.has(parent);
  });
}

/** State of a chunk of a set for its compensation (SPEC 8.5). */
export interface SetState {
  /**
   * Number of chunks of the equivalent prefix: the longest, up to the last chunk of the set, in which the chunk and its
   * descendants have no more splats than in the set.
   */
  readonly prefix: number;
  /**
   * Where that prefix has more chunks than the last layer: of the splats of the chunk and its descendants beyond that
   * layer, the share that is in the set.
   */
  readonly share: number | undefined;
}

/**
 * Return the state of each chunk of a set, for its compensation (SPEC 8.5). An unread page counts as one chunk.
 *
 * @param chunks - Numbers of known chunks, ascending, each with its parent in the set.
 * @param rows - Chunks and unread pages of the scene, `SceneIndex.rows`.
 * @param layerChunks - Chunks of the last layer, `PrefixCompensation.layerChunks`.
 * @param splats - Number of splats of each row.
 */
export function setStates(
  chunks: readonly number[],
  rows: SceneRows,
  layerChunks: number,
  splats: ArrayLike<number> = rows.splats,
): SetState[] {
  const end = chunks.length === 0 ? 0 : chunks[chunks.length - 1]! + 1;
  const { parents } = rows;
  /** Splats of each row's descendants: in the set, of chunks passed so far, of the last layer, and all. */
  const [held, passed, layered, all] = [0, 1, 2, 3].map(() => new Float64Array(rows.count)) as [
    Float64Array,
    Float64Array,
    Float64Array,
    Float64Array,
  ];
  const prefixes = new Map<number, number>();
  const heldRows = chunks.map((chunk) => rows.rowOf(chunk)!);
  for (const row of heldRows) {
    for (let above = row; above >= 0; above = parents[above]!) held[above]! += splats[row]!;
  }
  for (const row of rows.inFileOrder()) {
    const chunk = rows.chunks[row]!;
    for (let above = row; above >= 0; above = parents[above]!) {
      all[above]! += splats[row]!;
      if (chunk < layerChunks) layered[above]! += splats[row]!;
      if (chunk >= end) continue;
      passed[above]! += splats[row]!;
      if (passed[above]! > held[above]! && !prefixes.has(above)) prefixes.set(above, chunk);
    }
  }
  return heldRows.map((row) => {
    const prefix = prefixes.get(row) ?? end;
    if (prefix <= layerChunks) return { prefix, share: undefined };
    // Without descendants beyond the layer, all of them are in the set.
    const share = held[row] === all[row] ? 1 : (held[row]! - layered[row]!) / (all[row]! - layered[row]!);
    return { prefix, share };
  });
}
