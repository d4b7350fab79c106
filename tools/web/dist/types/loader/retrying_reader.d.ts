import type { ByteRange } from "../container/scene_index.js";
import { type Answer, type ByteSource } from "./byte_source.js";
import { type RetryOptions } from "./retry.js";
/** Reads ranges and asks again, after a pause, for what did not come. */
export declare class RetryingReader {
    private readonly source;
    private readonly retry;
    constructor(source: ByteSource, retry: RetryOptions);
    /**
     * The bytes of a range that may reach beyond the end of the file, in parts, as they come.
     *
     * @param receiver - `begin` is told of each answer, `take` receives the parts in order, without gaps.
     */
    beginning(range: ByteRange, signal: AbortSignal, receiver: {
        readonly begin: (answer: Answer) => void;
        readonly take: (part: Uint8Array) => void;
    }): Promise<void>;
    /** All bytes of a range. */
    all(range: ByteRange, signal: AbortSignal | undefined, fresh?: boolean): Promise<Uint8Array>;
    /**
     * The bytes of a range in parts, as they come; after a failure the rest is asked for.
     *
     * @param take - Receives the parts in order, without gaps.
     * @param priority - How soon they are wanted beside other requests.
     */
    parts(range: ByteRange, signal: AbortSignal, take: (part: Uint8Array) => void, priority?: RequestPriority): Promise<void>;
    /** @param received - Bytes so far: an attempt that brought some is none that failed. */
    private attempt;
}
