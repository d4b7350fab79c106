import type { ByteRange } from "../container/scene_index.js";

/** A gap that costs less to fetch than a request of its own, bytes (SPEC 8.8). */
const MAX_GAP = 65_536;
/** Most bytes of one request (SPEC 8.8). */
const MAX_REQUEST = 4 * 2 ** 20;

/** One request: a range, and the segments in it that were asked for, in file order. */
export interface RangeRequest extends ByteRange {
  readonly segments: readonly number[];
}

/**
 * Take the segments that come next from a list, as one range.
 *
 * @param wanted - Segments in the order in which they are wanted; those that are taken are removed.
 * @param rangeOf - Where a segment is in the file.
 * @param maxBytes - Most bytes of the request: small ones first, so that the first chunks come soon.
 * @param maxGap - Most bytes between two segments of a request; what lies there comes as well, and again where it is wanted later.
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
  const segments = wanted.splice(0, taken).sort((a, b) => rangeOf(a).offset - rangeOf(b).offset);
  return { offset, length: end - offset, segments };
}

/** Collects the bytes of one request and hands out each segment as soon as its last byte is there. */
export class RangeAssembler {
  private readonly bytes: Uint8Array;
  private received = 0;
  private next = 0;

  constructor(
    private readonly request: RangeRequest,
    private readonly rangeOf: (segment: number) => ByteRange,
  ) {
    this.bytes = new Uint8Array(request.length);
  }

  /** First byte that has not come. */
  get position(): number {
    return this.request.offset + this.received;
  }

  get complete(): boolean {
    return this.received === this.request.length;
  }

  /** Add bytes at `position`; what lies behind the range is left out. Gives the segments that are now whole. */
  add(part: Uint8Array): { segment: number; payload: Uint8Array }[] {
    const used = part.subarray(0, this.request.length - this.received);
    this.bytes.set(used, this.received);
    this.received += used.length;
    const whole = [];
    for (; this.next < this.request.segments.length; this.next++) {
      const segment = this.request.segments[this.next]!;
      const range = this.rangeOf(segment);
      if (range.offset + range.length > this.position) break;
      const start = range.offset - this.request.offset;
      whole.push({ segment, payload: this.bytes.slice(start, start + range.length) });
    }
    return whole;
  }
}
