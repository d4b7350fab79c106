import type { ByteRange } from "../container/scene_index.js";
import { type Answer, type ByteSource } from "./byte_source.js";
import { type RetryOptions } from "./retry.js";
/** Reads ranges and asks again, after a pause, for what did not come. */
export declare class RetryingReader {
    private readonly source;
    private readonly retry;
    constructor(source: ByteSource, retry: RetryOptions);
    /** The first bytes of the file, as many as there are up to `length`. */
    beginning(length: number, signal: AbortSignal | undefined): Promise<{
        bytes: Uint8Array;
        answer: Answer;
    }>;
    /** All bytes of a range. */
    all(range: ByteRange, signal: AbortSignal | undefined, fresh?: boolean): Promise<Uint8Array>;
    /**
     * The bytes of a range in parts, as they come; after a failure the rest is asked for.
     *
     * @param take - Receives the parts in order, without gaps.
     */
    parts(range: ByteRange, signal: AbortSignal, take: (part: Uint8Array) => void): Promise<void>;
    private attempt;
}
