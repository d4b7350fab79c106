/**
 * The chunk that each chunk adds detail to (SPEC 5.4).
 *
 * @param cells - Number of each chunk's cell, 0 where chunks are not cut by cell.
 * @returns A number for each chunk; -1 where it has no parent.
 */
export declare function parentsOf(cells: ArrayLike<number>): Int32Array;
/** Whether a set of chunks, ascending, holds with each chunk its parent. */
export declare function isClosed(chunks: readonly number[], parents: Int32Array): boolean;
/**
 * The prefix that each chunk of a set is compensated as (SPEC 8.5): the longest, up to the last chunk of the set, in
 * which the chunk and its descendants have no more splats than in the set.
 *
 * @param chunks - Numbers of the set, ascending, with each chunk its parent.
 * @param parents - Of each chunk of the file, as {@link parentsOf} gives them.
 * @param splats - Of each chunk of the file.
 * @returns For each chunk of the set the chunks of its prefix.
 */
export declare function equivalentPrefixes(chunks: readonly number[], parents: Int32Array, splats: ArrayLike<number>): number[];
