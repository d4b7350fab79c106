import type { WorkerLike } from "../workers/decoder_pool.js";

/** Makes the workers of a viewer. */
export interface ViewerWorkers {
  /** Make a worker that decodes chunks: the program `worker.js`. */
  decoder(): WorkerLike;
  /** Make a worker that sorts rows or reads a PLY: the program `viewer_worker.js`. */
  viewer(): Worker;
}

/** Return workers whose programs are next to the viewer's own, as a policy `worker-src 'self'` allows. */
export function workersBeside(base: string): ViewerWorkers {
  const start = (name: string) => new Worker(new URL(name, base), { type: "module" });
  return { decoder: () => start("worker.js"), viewer: () => start("viewer_worker.js") };
}

/** Return workers whose programs are texts in the page; a policy must allow `worker-src blob:`. */
export function workersOfTexts(decoder: string, viewer: string): ViewerWorkers {
  const start = (text: string) => {
    const url = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    // Not a module: pages opened as local files have no origin from which to fetch one.
    return () => new Worker(url);
  };
  return { decoder: start(decoder), viewer: start(viewer) };
}

/** Workers, if the page's policy allows any. */
export class AllowedWorkers {
  /** The workers; undefined where a policy refuses workers, or the program cannot be fetched. */
  readonly found: Promise<ViewerWorkers | undefined>;
  /** The workers, once `found` has resolved. */
  known: ViewerWorkers | undefined;
  private first: WorkerLike | undefined;

  /** Start a decoding worker at once: its program arrives together with the first bytes of a scene. */
  constructor(workers: ViewerWorkers | undefined) {
    this.found = workers === undefined ? Promise.resolve(undefined) : this.start(workers);
  }

  /** Take the worker started first, if it is still there. */
  takeFirst(): WorkerLike | undefined {
    const { first } = this;
    this.first = undefined;
    return first;
  }

  close(): void {
    this.takeFirst()?.terminate();
  }

  private start(workers: ViewerWorkers): Promise<ViewerWorkers | undefined> {
    return new Promise((resolve) => {
      try {
        const worker = workers.decoder();
        this.first = worker;
        // Most browsers report a refusal by an event, some by an exception.
        worker.onerror = () => {
          this.close();
          resolve(undefined);
        };
        worker.onmessage = () => {
          this.known = workers;
          resolve(workers);
        };
      } catch {
        // The constructor throws SecurityError: without workers, work is done in slices on the main thread.
        resolve(undefined);
      }
    });
  }
}
