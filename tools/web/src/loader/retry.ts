import { SourceError } from "../errors.js";

/** Number and timing of retries. */
export interface RetryOptions {
  /** Number of retries of a request without progress in between: 16 KiB of new bytes. */
  readonly retries: number;
  /** First pause, ms; each later pause is twice as long, up to `longest`. */
  readonly pause: number;
  /** Longest pause, ms. */
  readonly longest: number;
  /** Longest wait that a server may request, ms; the request fails if the server requests more. */
  readonly longestWait: number;
}

export const DEFAULT_RETRY: RetryOptions = { retries: 4, pause: 250, longest: 8_000, longestWait: 60_000 };

/** Return whether a retry may help: not after a refusal of the file, nor after an abort. */
export function isRetryable(error: unknown): boolean {
  return error instanceof SourceError && error.retryable;
}

/** Return the wait that a server requested with its error (`Retry-After`), ms; 0 for none. */
export function requestedWait(error: unknown): number {
  return error instanceof SourceError ? (error.retryAfter ?? 0) : 0;
}

/**
 * Wait before a retry: the wait that the server requested, then a pause, of which half is random.
 *
 * @param attempt - Number of the retry, from 1.
 * @param asked - Wait that the server requested, ms.
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
