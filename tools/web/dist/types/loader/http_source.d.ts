import type { ByteRange } from "../container/scene_index.js";
import { type Answer, type ByteSource, type ReadOptions } from "./byte_source.js";
/** How requests are made. */
export interface HttpOptions {
    /** Headers of every request, such as an authorisation. */
    readonly headers?: Readonly<Record<string, string>>;
    readonly credentials?: RequestCredentials;
    /** Longest time without a byte, ms, after which a request is made again; 15,000 by default. */
    readonly longestPause?: number;
    /** Go around caches with every request, as for a file that has changed. */
    readonly fresh?: boolean;
    /** In the place of the global `fetch`. */
    readonly fetch?: typeof fetch;
}
/** A file on a server that answers ranges; one that does not is read from the front. */
export declare class HttpSource implements ByteSource {
    private readonly url;
    private readonly options;
    /** Whether all of a scene has this address. */
    private readonly isWhole;
    private etag;
    private total;
    constructor(url: string | URL, options?: HttpOptions, 
    /** Whether all of a scene has this address. */
    isWhole?: boolean);
    read(range: ByteRange, options?: ReadOptions): Promise<Answer>;
    /** A file that is named relative to this one; the query of the address is kept, which may hold a signature for all. */
    beside(name: string): HttpSource;
    private request;
    private get longestPause();
    /** Accept an answer, or say what is wrong with it; its body was not read yet. */
    private check;
    /** Refuse an answer of another file than that of the first answer; weak ETags say nothing of bytes. */
    private compare;
}
/**
 * The wait that a server asks for, ms: a number of seconds, or a date by the server's own clock (RFC 9110, 10.2.3).
 *
 * @returns undefined where the header is not there or says nothing that can be read.
 */
export declare function retryAfter(header: string | null, date: string | null): number | undefined;
