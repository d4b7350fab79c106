import type { FeedProgress } from "./scene_feed.js";

/** Progress of a scene; its length if known. */
type Arrived = Pick<FeedProgress, "splats" | "totalSplats" | "bytes"> & { readonly totalBytes?: number | undefined };

/**
 * Estimate the time until a scene is complete from its average speed so far.
 *
 * Bytes and splats both count, because received bytes still have to be decoded. Without progress the estimate grows.
 *
 * @param passed - Time since the first bytes, ms.
 * @returns Milliseconds; Infinity where no estimate is possible.
 */
export function millisecondsLeft(progress: Arrived, passed: number): number {
  const { splats, totalSplats, bytes, totalBytes } = progress;
  if (totalBytes === undefined || splats === 0 || bytes === 0) return Infinity;
  return passed * Math.max((totalBytes - bytes) / bytes, (totalSplats - splats) / splats, 0);
}
