import { CogsplatError } from "../errors.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import type { ChunkService, DecodedChunk, DecodeTask } from "./decode_task.js";
import type { Request, Response } from "./messages.js";

/** Part of a browser's `Worker` that a pool uses. */
export interface WorkerLike {
  onmessage: ((event: MessageEvent<Response>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
  onmessageerror?: ((event: MessageEvent) => void) | null;
  postMessage(message: Request): void;
  terminate(): void;
}

/** Options of a pool. */
export interface PoolOptions {
  /** Number of workers; by default one less than the machine has cores, at most 4. */
  readonly workers?: number;
  /** Makes a worker; by default from `worker.js` next to this file, which a policy `worker-src 'self'` allows. */
  readonly makeWorker?: () => WorkerLike;
}

interface Task {
  readonly worker: number;
  readonly resolve: (decoded: DecodedChunk) => void;
  readonly reject: (error: unknown) => void;
}

/** Decoder in workers. No memory is shared, so pages need no cross-origin isolation. */
export class DecoderPool implements ChunkService {
  private readonly workers: WorkerLike[];
  private readonly tasks = new Map<number, Task>();
  private readonly load: number[];
  private nextId = 0;

  constructor(index: DecoderIndex, options: PoolOptions = {}) {
    const cores = globalThis.navigator?.hardwareConcurrency ?? 2;
    const count = options.workers ?? Math.max(1, Math.min(4, cores - 1));
    const make = options.makeWorker ?? makeWorker;
    this.load = new Array<number>(count).fill(0);
    this.workers = this.load.map((_, number) => {
      const worker = make();
      worker.onmessage = ({ data }) => this.onAnswer(data);
      worker.onerror = (event) => this.onCrash(number, event.message);
      // Without this, an answer that cannot be read would be waited for.
      worker.onmessageerror = () => this.onCrash(number, "an unreadable message");
      worker.postMessage({ type: "scene", index });
      return worker;
    });
  }

  addCodebook(codebook: number, kind: number, payload: Uint8Array): void {
    for (const worker of this.workers) worker.postMessage({ type: "codebook", codebook, kind, payload });
  }

  decode(task: DecodeTask): Promise<DecodedChunk> {
    const least = Math.min(...this.load);
    if (least === Infinity) return Promise.reject(new Error("every worker failed"));
    const worker = this.load.indexOf(least);
    const id = this.nextId++;
    this.load[worker]!++;
    return new Promise((resolve, reject) => {
      this.tasks.set(id, { worker, resolve, reject });
      this.workers[worker]!.postMessage({ type: "chunk", id, task });
    });
  }

  close(): void {
    for (const worker of this.workers) worker.terminate();
    for (const [id, task] of this.tasks) {
      this.tasks.delete(id);
      task.reject(new Error("the pool of workers was closed"));
    }
  }

  private onAnswer(response: Response): void {
    if ("ready" in response) return;
    const task = this.tasks.get(response.id);
    if (task === undefined) return;
    this.tasks.delete(response.id);
    this.load[task.worker]!--;
    if ("decoded" in response) task.resolve(response.decoded);
    else if (response.code === undefined) task.reject(new Error(response.message));
    else task.reject(new CogsplatError(response.code, response.message, response.offset));
  }

  /** Reject the chunks of a worker that ended, for example for lack of memory. */
  private onCrash(number: number, message: string): void {
    this.load[number] = Infinity;
    for (const [id, task] of this.tasks) {
      if (task.worker !== number) continue;
      this.tasks.delete(id);
      task.reject(new Error(`a worker failed: ${message}`));
    }
  }
}

function makeWorker(): WorkerLike {
  return new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
}
