import type { LevelEntry } from "../container/root.js";

/*
 * Levels of a scene for pictures of several sizes (SPEC 5.11). A place between two of them is a number: 1.25 is a quarter
 * of the way from level 1 to level 2.
 */

/**
 * The level for pictures of a size (SPEC 8.11).
 *
 * @param levels - At least one, the coarsest first.
 * @param size - What the full width is multiplied by.
 */
export function levelForSize(levels: readonly LevelEntry[], size: number): number {
  const sizes = levels.map(({ scale }) => 1 / scale);
  const above = sizes.findIndex((other) => other > size);
  if (above < 0) return levels.length - 1;
  return above === 0 ? 0 : above - 1 + (size - sizes[above - 1]!) / (sizes[above]! - sizes[above - 1]!);
}

/** How far a prefix of so many chunks has come: from a level that is whole towards the next one, by the chunks that are there. */
export function levelOfPrefix(levels: readonly LevelEntry[], chunks: number): number {
  const next = levels.findIndex((level) => level.chunks > chunks);
  if (next < 0) return levels.length - 1;
  if (next === 0) return 0;
  const whole = levels[next - 1]!.chunks;
  return next - 1 + (chunks - whole) / (levels[next]!.chunks - whole);
}
