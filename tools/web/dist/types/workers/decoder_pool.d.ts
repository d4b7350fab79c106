import type { DecoderIndex } from "../scene/chunk_decoder.js";
import type { ChunkService, DecodedChunk, DecodeTask } from "./decode_task.js";
import type { Request, Response } from "./messages.js";
/** What a pool needs of a worker; a browser's `Worker` has it. */
export interface WorkerLike {
    onmessage: ((event: MessageEvent<Response>) => void) | null;
    onerror: ((event: ErrorEvent) => void) | null;
    postMessage(message: Request): void;
    terminate(): void;
}
/** How a pool is made. */
export interface PoolOptions {
    /** Number of workers; by default one less than the machine has cores, at most 4. */
    readonly workers?: number;
    /** Makes a worker; by default from `worker.js` beside this file, which a policy `worker-src 'self'` allows. */
    readonly makeWorker?: () => WorkerLike;
}
/** Decodes chunks in workers. No memory is shared, so pages need no cross-origin isolation. */
export declare class DecoderPool implements ChunkService {
    private readonly workers;
    private readonly tasks;
    private readonly load;
    private nextId;
    constructor(index: DecoderIndex, options?: PoolOptions);
    addCodebook(codebook: number, kind: number, payload: Uint8Array): void;
    decode(task: DecodeTask): Promise<DecodedChunk>;
    close(): void;
    private answered;
    /** A worker that ended, by lack of memory for example, takes its chunks with it. */
    private crashed;
}
