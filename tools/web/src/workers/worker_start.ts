import type { Request, Response } from "./messages.js";

/** Part of a browser's `Worker` that decoding uses. */
export interface WorkerLike {
  onmessage: ((event: MessageEvent<Response>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
  onmessageerror?: ((event: MessageEvent) => void) | null;
  postMessage(message: Request): void;
  terminate(): void;
}

/** Way to start decoding workers. */
export interface WorkerWay {
  /** Address of the worker's program, for messages. */
  readonly address: string;
  /** Start a worker; may throw where a policy refuses workers. */
  start(): WorkerLike;
}

/** A way that works, and the worker that proved it. */
export interface RunningWay<W extends WorkerWay = WorkerWay> {
  readonly way: W;
  readonly first: WorkerLike | undefined;
}

/**
 * Start a worker in the first way that works: bundlers and policies allow different ones.
 *
 * If none works, a message in the console states each address and its fault.
 *
 * @param signal - Ends the search and its worker.
 * @returns undefined if none works, or after `signal`.
 */
export async function findRunningWay<W extends WorkerWay>(
  ways: readonly W[],
  signal: AbortSignal,
): Promise<RunningWay<W> | undefined> {
  const faults: string[] = [];
  for (const way of ways) {
    try {
      const first = way.start();
      const fault = await faultOf(first, way.address, signal);
      if (fault === undefined && !signal.aborted) return { way, first };
      first.terminate();
      if (signal.aborted) return undefined;
      faults.push(fault!);
    } catch (error) {
      faults.push(failureText((error as Error).message, way.address));
    }
  }
  const reasons = faults.length > 0 ? faults.join("; ") : "this environment has none";
  console.warn(`cogsplat decodes without workers, which is slower: ${reasons}`);
  return undefined;
}

/** Wait until a worker runs; return undefined, or why it does not. */
function faultOf(worker: WorkerLike, address: string, signal: AbortSignal): Promise<string | undefined> {
  return new Promise((resolve) => {
    signal.addEventListener("abort", () => resolve(undefined), { once: true });
    worker.onmessage = () => resolve(undefined);
    // Most browsers report a refusal by an event without a message, some by an exception.
    worker.onerror = (event) => resolve(failureText(event.message, address));
  });
}

/** Return the message of a failed worker; browsers state no reason where a program cannot be fetched. */
export function failureText(reason: string | undefined, address: string): string {
  const known = reason || "it cannot be fetched, or the page's Content-Security-Policy forbids it (worker-src)";
  return `a worker failed (${address}): ${known}`;
}

/** Address, for messages, of a worker whose program is a text. */
export const TEXT_ADDRESS = "blob:, its program is a text of the page";

/** Return a function that starts workers whose program is a text; a policy must allow `worker-src blob:`. */
export function startsText(text: string): () => Worker {
  let url: string | undefined;
  return () => {
    url ??= URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    // Not a module: pages opened as local files have no origin from which to fetch one.
    return new Worker(url);
  };
}
