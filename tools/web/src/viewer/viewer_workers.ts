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
