/** A segment that a client may fetch; units stand in the order of the file. */
export interface Unit {
    /** −1 for one that belongs to no chunk, such as a segment of a codebook. */
    readonly chunk: number;
    readonly isHead: boolean;
    /** Byte of the file behind the segment. */
    readonly end: number;
    readonly size: number;
    /** Units that it is of no use without; the head of a chunk names that of its parent. */
    readonly after: readonly number[];
}
/** What a client has, and its means. */
export interface Holdings {
    /** Units that have come. */
    readonly there: ReadonlySet<number>;
    /** Units that are asked for. */
    readonly underWay: ReadonlySet<number>;
    /** Bytes that have come of units that are not whole, under way or stopped. */
    readonly received: ReadonlyMap<number, number>;
    /** Most splats of chunks whose heads are there or under way; 0 for any number. */
    readonly budgetSplats: number;
    /** What the connection is thought to bring. */
    readonly bytesPerSecond: number;
    /** Seconds from a request to its first byte. */
    readonly latency: number;
}
/** What a client does now, in this order. */
export interface Decision {
    /** Units under way that are no longer wanted now; what has come of them stays. */
    readonly stop: readonly number[];
    /** Chunks whose units are thrown away. */
    readonly evict: readonly number[];
    /** Units to ask for, the first first. */
    readonly fetch: readonly number[];
}
/** How many bytes are kept under way, at least (docs/streaming.md, 7). */
export declare function windowBytes(bytesPerSecond: number, latency: number): number;
/** Decides what to fetch next, what to stop and what to throw away (docs/streaming.md, 7 to 9). */
export declare class Scheduler {
    private readonly units;
    private readonly splats;
    private readonly heads;
    /** Ratios of the last decision, and the order that follows from them. */
    private last;
    constructor(units: readonly Unit[], splats: ArrayLike<number>);
    /** What a byte of each unit is thought to gain: its chunk's ratio over the square of its place in the file. */
    urgency(ratios: Float64Array): Float64Array;
    decide(ratios: Float64Array, holdings: Holdings): Decision;
    /** Urgencies and units by them; ratios that are asked about again are not put in order again. */
    private ordered;
}
