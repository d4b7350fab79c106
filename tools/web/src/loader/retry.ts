import { SourceError } from "../errors.js";

/** Number and timing of retries. */
export interface RetryOptions {
  /** Number of retries after the first attempt. */
  readonly retries: number;
  /** First pause, ms; each next one is twice as long, up to `longest`. */
  readonly pause: number;
  readonly longest: number;
  /** Longest wait that a server may ask for, ms; a longer one fails the request. */
  readonly longestWait: number;
}

export const DEFAULT_RETRY: RetryOptions = { retries: 4, pause: 250, longest: 8_000, longestWait: 60_000 };

/** Return whether a retry may help: not after a refusal of the file, nor after an abort. */
export function isRetryable(error: unknown): boolean {
  // Bodies throw a TypeError when a connection breaks, in browsers and in Node.
  return error instanceof SourceError ? error.retryable : error instanceof TypeError;
}

/** Return the wait that a server asked for with an error, ms; 0 for none. */
export function requestedWait(error: unknown): number {
  return error instanceof SourceError ? (error.retryAfter ?? 0) : 0;
}

/**
 * Wait before a retry: half of the pause fixed, half random, after the wait that the server asked for.
 *
 * @param attempt - Number of the retry, from 1.
 * @param asked - Wait that the server asked for, ms.
 */
export async function backOff(
  attempt: number,
  { pause, longest }: RetryOptions,
  signal: AbortSignal | undefined,
  asked = 0,
): Promise<void> {
  const full = Math.min(longest, pause * 2 ** (attempt - 1));
  await new Promise<void>((resolve, reject) => {
    const timer = setTimeout(done, asked + full / 2 + Math.random() * (full / 2));
    function done(): void {
      signal?.removeEventListener("abort", aborted);
      resolve();
    }
    function aborted(): void {
      clearTimeout(timer);
      reject(signal!.reason as Error);
    }
    if (signal?.aborted) aborted();
    else signal?.addEventListener("abort", aborted, { once: true });
  });
}
