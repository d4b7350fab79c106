/** How often and after which pauses a request is made again. */
export interface RetryOptions {
    /** Attempts after the first. */
    readonly retries: number;
    /** First pause, ms; each next one is twice as long, up to `longest`. */
    readonly pause: number;
    readonly longest: number;
}
export declare const DEFAULT_RETRY: RetryOptions;
/** Whether asking again may help: not after a refusal of the file, nor after an abort. */
export declare function isRetryable(error: unknown): boolean;
/** Wait before attempt `attempt`, counted from 1: half of the pause fixed, half by chance. */
export declare function backOff(attempt: number, { pause, longest }: RetryOptions, signal: AbortSignal | undefined): Promise<void>;
