import { CogsplatError } from "../errors.js";
import { loadKernels } from "../kernels/load.js";
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import { type ChunkService, type DecodedChunk, type DecodeTask, SlicedService } from "./decode_task.js";
import type { Request, Response } from "./messages.js";
import { failureText, findRunningWay, type RunningWay, type WorkerLike } from "./worker_start.js";
import { decoderWays } from "./worker_ways.js";

/** Options of a pool. */
export interface PoolOptions {
  /** Number of workers; by default one less than the machine has cores, at most 4. */
  readonly workers?: number;
  /**
   * Makes a worker of the program `cogsplat/worker`. By default its text in this module, which works in every bundler,
   * and where a policy refuses that, the file `worker.js`.
   */
  readonly makeWorker?: () => WorkerLike;
  /**
   * Way known to work, and a worker already started.
   *
   * @internal
   */
  readonly running?: RunningWay;
}

interface Task {
  readonly worker: number;
  readonly resolve: (decoded: DecodedChunk) => void;
  readonly reject: (error: unknown) => void;
}

/**
 * Decoder in workers. No memory is shared, so pages need no cross-origin isolation.
 *
 * Where no worker can be started, chunks are decoded on the caller's thread, and a message in the console says why.
 */
export class DecoderPool implements ChunkService {
  private workers: readonly WorkerLike[] = [];
  private readonly tasks = new Map<number, Task>();
  private load: number[] = [];
  private nextId = 0;
  private address = "";
  /** Codebooks that arrived before the workers ran. */
  private early: Request[] = [];
  private readonly abort = new AbortController();
  /** Resolves when workers run, to undefined, or to the decoder on this thread. */
  private readonly opened: Promise<ChunkService | undefined>;
  private local: ChunkService | undefined;

  constructor(index: DecoderIndex, options: PoolOptions = {}) {
    this.opened = this.open(index, options);
    // Every chunk is refused with the error.
    this.opened.catch(() => undefined);
  }

  addCodebook(codebook: number, kind: number, payload: Uint8Array): void {
    if (this.local !== undefined) {
      this.local.addCodebook(codebook, kind, payload);
      return;
    }
    const request: Request = { type: "codebook", codebook, kind, payload };
    if (this.workers.length === 0) this.early.push(request);
    for (const worker of this.workers) worker.postMessage(request);
  }

  async decode(task: DecodeTask): Promise<DecodedChunk> {
    const local = await this.opened;
    if (this.abort.signal.aborted) throw closed();
    if (local !== undefined) return local.decode(task);
    const least = Math.min(...this.load);
    if (least === Infinity) throw new Error(`every worker failed (${this.address})`);
    const worker = this.load.indexOf(least);
    const id = this.nextId++;
    this.load[worker]!++;
    return new Promise((resolve, reject) => {
      this.tasks.set(id, { worker, resolve, reject });
      this.workers[worker]!.postMessage({ type: "chunk", id, task });
    });
  }

  close(): void {
    this.abort.abort();
    for (const worker of this.workers) worker.terminate();
    for (const [id, task] of this.tasks) {
      this.tasks.delete(id);
      task.reject(closed());
    }
  }

  private async open(
    index: DecoderIndex,
    { makeWorker, running, workers }: PoolOptions,
  ): Promise<ChunkService | undefined> {
    const ways = makeWorker ? [{ address: "the option makeWorker", start: makeWorker }] : decoderWays();
    const found = running ?? (await findRunningWay(ways, this.abort.signal));
    if (this.abort.signal.aborted) {
      found?.first?.terminate();
      return undefined;
    }
    if (found === undefined) {
      const local = new SlicedService(index, await loadKernels());
      for (const request of this.early) {
        if (request.type === "codebook") local.addCodebook(request.codebook, request.kind, request.payload);
      }
      this.early = [];
      this.local = local;
      return local;
    }
    const { way, first } = found;
    const cores = globalThis.navigator?.hardwareConcurrency ?? 2;
    const count = workers ?? Math.max(1, Math.min(4, cores - 1));
    this.address = way.address;
    this.load = new Array<number>(count).fill(0);
    this.workers = this.load.map((_, number) => {
      const worker = number === 0 && first !== undefined ? first : way.start();
      worker.onmessage = ({ data }) => this.onAnswer(data);
      worker.onerror = (event) => this.onCrash(number, event.message);
      // Without this, an answer that cannot be read would be waited for.
      worker.onmessageerror = () => this.onCrash(number, "an unreadable message");
      worker.postMessage({ type: "scene", index });
      for (const request of this.early) worker.postMessage(request);
      return worker;
    });
    this.early = [];
    return undefined;
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
  private onCrash(number: number, reason: string): void {
    this.load[number] = Infinity;
    for (const [id, task] of this.tasks) {
      if (task.worker !== number) continue;
      this.tasks.delete(id);
      task.reject(new Error(failureText(reason, this.address)));
    }
  }
}

function closed(): Error {
  return new Error("the pool of workers was closed");
}
