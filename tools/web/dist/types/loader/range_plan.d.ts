import type { ByteRange } from "../container/scene_index.js";
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
export declare function nextRequest(wanted: number[], rangeOf: (segment: number) => ByteRange, maxBytes?: number, maxGap?: number): RangeRequest | undefined;
/** Collects the bytes of one request and hands out each segment as soon as its last byte is there. */
export declare class RangeAssembler {
    private readonly request;
    private readonly rangeOf;
    private readonly bytes;
    private received;
    private next;
    constructor(request: RangeRequest, rangeOf: (segment: number) => ByteRange);
    /** First byte that has not come. */
    get position(): number;
    get complete(): boolean;
    /** Add bytes at `position`; what lies behind the range is left out. Gives the segments that are now whole. */
    add(part: Uint8Array): {
        segment: number;
        payload: Uint8Array;
    }[];
}
