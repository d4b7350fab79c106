import type { LevelEntry } from "../container/root.js";
/**
 * The level for pictures of a size (SPEC 8.11).
 *
 * @param levels - At least one, the coarsest first.
 * @param size - What the full width is multiplied by.
 */
export declare function levelForSize(levels: readonly LevelEntry[], size: number): number;
/** How far a prefix of so many chunks has come: from a level that is whole towards the next one, by the chunks that are there. */
export declare function levelOfPrefix(levels: readonly LevelEntry[], chunks: number): number;
