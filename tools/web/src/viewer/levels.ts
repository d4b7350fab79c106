import type { LevelEntry } from "../container/root.js";

/*
 * Levels of a scene for pictures of several sizes (SPEC 5.11). A number between two levels is allowed: 1.25 is a quarter
 * of the way from level 1 to level 2.
 */

/**
 * Return the level for pictures of a size (SPEC 8.11).
 *
 * @param levels - Levels, coarsest first; at least one.
 * @param size - Factor of the full width.
 */
export function levelForSize(levels: readonly LevelEntry[], size: number): number {
  const sizes = levels.map(({ scale }) => 1 / scale);
  const above = sizes.findIndex((other) => other > size);
  if (above < 0) return levels.length - 1;
  return above === 0 ? 0 : above - 1 + (size - sizes[above - 1]!) / (sizes[above]! - sizes[above - 1]!);
}

/** Return the level that a prefix has reached, interpolated between two levels by chunks. */
export function levelOfPrefix(levels: readonly LevelEntry[], chunks: number): number {
  const next = levels.findIndex((level) => level.chunks > chunks);
  if (next < 0) return levels.length - 1;
  if (next === 0) return 0;
  const whole = levels[next - 1]!.chunks;
  return next - 1 + (chunks - whole) / (levels[next]!.chunks - whole);
}
