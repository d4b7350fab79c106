import {
  findRunningWay,
  type RunningWay,
  startsText,
  TEXT_ADDRESS,
  type WorkerLike,
  type WorkerWay,
} from "../workers/worker_start.js";

/** Makes the workers of a viewer: `start` one that decodes chunks, the program `worker.js`. */
export interface ViewerWorkers extends WorkerWay {
  /** Make a worker that sorts rows or reads a PLY: the program `viewer_worker.js`. */
  viewer(): Worker;
  /** Workers to try if the first kind cannot be started. */
  readonly otherwise?: ViewerWorkers;
}

/** Return workers whose programs are next to the viewer's own, as a policy `worker-src 'self'` allows. */
export function workersBeside(base: string): ViewerWorkers {
  const start = (name: string) => new Worker(new URL(name, base), { type: "module" });
  return {
    // A bundler may have left no address, which is no fault until a worker is started.
    get address() {
      return new URL("worker.js", base).href;
    },
    start: () => start("worker.js"),
    viewer: () => start("viewer_worker.js"),
  };
}

/** Return workers whose programs are texts in the page; a policy must allow `worker-src blob:`. */
export function workersOfTexts(decoder: string, viewer: string): ViewerWorkers {
  return { address: TEXT_ADDRESS, start: startsText(decoder), viewer: startsText(viewer) };
}

/** Workers, if the page's policy allows any. */
export class AllowedWorkers {
  /** The workers; undefined where a policy refuses workers, or the program cannot be fetched. */
  readonly found: Promise<ViewerWorkers | undefined>;
  /** The workers, once `found` has resolved. */
  known: ViewerWorkers | undefined;
  private first: WorkerLike | undefined;
  private readonly abort = new AbortController();

  /** Start a decoding worker at once: its program arrives together with the first bytes of a scene. */
  constructor(workers: ViewerWorkers | undefined) {
    this.found = workers === undefined ? Promise.resolve(undefined) : this.find(workers);
  }

  /** Return the way found, with the worker started first if it is still there. */
  takeRunning(way: ViewerWorkers): RunningWay {
    const { first } = this;
    this.first = undefined;
    return { way, first };
  }

  close(): void {
    this.abort.abort();
    this.first?.terminate();
    this.first = undefined;
  }

  private async find(workers: ViewerWorkers): Promise<ViewerWorkers | undefined> {
    const ways = workers.otherwise === undefined ? [workers] : [workers, workers.otherwise];
    const running = await findRunningWay(ways, this.abort.signal);
    this.known = running?.way;
    this.first = running?.first;
    return this.known;
  }
}
