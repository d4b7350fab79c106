import type { ByteRange } from "../container/scene_index.js";
import type { Answer, ByteSource, ReadOptions } from "../loader/byte_source.js";
/** Counts the bytes that come, and where a rate is set lets them come no faster. */
export declare class Meter {
    /** Bytes that have come. */
    bytes: number;
    /** When the first of them came, by `performance.now`. */
    since: number | undefined;
    /** Most bits a second; Infinity as fast as they come. */
    bitsPerSecond: number;
    /** When all bytes so far would have come at the rate, ms. */
    private due;
    /** Count from nothing on. */
    reset(): void;
    /** The same parts, counted, and no faster than the rate. */
    through(parts: AsyncIterable<Uint8Array>): AsyncGenerator<Uint8Array>;
}
/** A source whose bytes go through a meter. */
export declare class MeteredSource implements ByteSource {
    private readonly source;
    private readonly meter;
    constructor(source: ByteSource, meter: Meter);
    read(range: ByteRange, options?: ReadOptions): Promise<Answer>;
    beside(name: string): ByteSource;
}
