import type { WorkerLike } from "../workers/decoder_pool.js";

/** How a viewer starts its workers. */
export interface ViewerWorkers {
  /** One that decodes chunks: the program `worker.js`. */
  decoder(): WorkerLike;
  /** One that sorts rows or reads a PLY: the program `viewer_worker.js`. */
  viewer(): Worker;
}

/** Workers whose programs lie beside the viewer's own; a policy `worker-src 'self'` allows them. */
export function workersBeside(base: string): ViewerWorkers {
  const start = (name: string) => new Worker(new URL(name, base), { type: "module" });
  return { decoder: () => start("worker.js"), viewer: () => start("viewer_worker.js") };
}

/** Workers whose programs are texts that the page holds; a policy must allow `worker-src blob:`. */
export function workersOfTexts(decoder: string, viewer: string): ViewerWorkers {
  const start = (text: string) => {
    const url = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    // No module: pages that are opened as files have no origin that a module could be fetched for.
    return () => new Worker(url);
  };
  return { decoder: start(decoder), viewer: start(viewer) };
}

/** Workers as far as the page allows them. */
export class AllowedWorkers {
  /** The workers; undefined where a policy of the page refuses them, or their program cannot be had. */
  readonly found: Promise<ViewerWorkers | undefined>;
  /** The same, once it is known. */
  known: ViewerWorkers | undefined;
  private first: WorkerLike | undefined;

  /** Start a decoder's worker at once: its program comes while the first bytes of a scene do. */
  constructor(workers: ViewerWorkers | undefined) {
    this.found = workers === undefined ? Promise.resolve(undefined) : this.start(workers);
  }

  /** Take the worker that was started first, where it was not taken yet. */
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
        // Most browsers tell of a refusal by an event, some by an exception.
        worker.onerror = () => {
          this.close();
          resolve(undefined);
        };
        worker.onmessage = () => {
          this.known = workers;
          resolve(workers);
        };
      } catch {
        // The constructor throws SecurityError: there are none, and work is done in slices where the page runs.
        resolve(undefined);
      }
    });
  }
}
