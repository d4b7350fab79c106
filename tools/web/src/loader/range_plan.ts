import type { ByteRange } from "../container/scene_index.js";

/** Longest gap, bytes, that costs less to fetch than a request of its own (SPEC 8.8). */
const MAX_GAP = 65_536;
/** Bytes of one request at most (SPEC 8.8). */
const MAX_REQUEST = 4 * 2 ** 20;

/** One request: a byte range and the segments to take from it, in file order. */
export interface RangeRequest extends ByteRange {
  readonly segments: readonly number[];
}

/**
 * Remove the next segments from a list and join their ranges into one request.
 *
 * @param wanted - Segments in the order of their urgency.
 * @param rangeOf - Byte range of a segment.
 * @param maxBytes - Bytes of the request at most; small first requests bring the first chunks soon.
 * @param maxGap - Bytes between two segments of a request at most; bytes of a gap are fetched and dropped.
 */
export function nextRequest(
  wanted: number[],
  rangeOf: (segment: number) => ByteRange,
  maxBytes = MAX_REQUEST,
  maxGap = MAX_GAP,
): RangeRequest | undefined {
  const first = wanted[0];
  if (first === undefined) return undefined;
  let { offset } = rangeOf(first);
  let end = offset + rangeOf(first).length;
  let taken = 1;
  for (; taken < wanted.length; taken++) {
    const next = rangeOf(wanted[taken]!);
    const start = Math.min(offset, next.offset);
    const stop = Math.max(end, next.offset + next.length);
    const gap = Math.max(next.offset - end, offset - (next.offset + next.length), 0);
    if (gap > maxGap || stop - start > Math.min(maxBytes, MAX_REQUEST)) break;
    [offset, end] = [start, stop];
  }
  const segments: number[] = [];
  let last: ByteRange | undefined;
  for (const segment of wanted.splice(0, taken).sort((a, b) => rangeOf(a).offset - rangeOf(b).offset)) {
    const range = rangeOf(segment);
    const isSame = range.offset === last?.offset && range.length === last.length;
    // Segments of a folder may share bytes of an object; those that share a part come by a request of their own.
    if (last === undefined || isSame || range.offset >= last.offset + last.length) {
      segments.push(segment);
      last = range;
    } else wanted.unshift(segment);
  }
  return { offset, length: end - offset, segments };
}
