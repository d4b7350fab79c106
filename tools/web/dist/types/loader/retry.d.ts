/** How often and after which pauses a request is made again. */
export interface RetryOptions {
    /** Attempts after the first. */
    readonly retries: number;
    /** First pause, ms; each next one is twice as long, up to `longest`. */
    readonly pause: number;
    readonly longest: number;
    /** Longest wait that a server may ask for, ms; where it asks for more, the request has failed. */
    readonly longestWait: number;
}
export declare const DEFAULT_RETRY: RetryOptions;
/** Whether asking again may help: not after a refusal of the file, nor after an abort. */
export declare function isRetryable(error: unknown): boolean;
/** The wait that a server asked for with an error, ms; 0 where it asked for none. */
export declare function askedWait(error: unknown): number;
/**
 * Wait before attempt `attempt`, counted from 1: half of the pause fixed, half by chance, and no less than was asked for.
 *
 * @param asked - What the server asked for, ms.
 */
export declare function backOff(attempt: number, { pause, longest }: RetryOptions, signal: AbortSignal | undefined, asked?: number): Promise<void>;
