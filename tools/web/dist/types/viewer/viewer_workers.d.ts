import type { WorkerLike } from "../workers/decoder_pool.js";
/** How a viewer starts its workers. */
export interface ViewerWorkers {
    /** One that decodes chunks: the program `worker.js`. */
    decoder(): WorkerLike;
    /** One that sorts rows or reads a PLY: the program `viewer_worker.js`. */
    viewer(): Worker;
}
/** Workers whose programs lie beside the viewer's own; a policy `worker-src 'self'` allows them. */
export declare function workersBeside(base: string): ViewerWorkers;
/** Workers whose programs are texts that the page holds; a policy must allow `worker-src blob:`. */
export declare function workersOfTexts(decoder: string, viewer: string): ViewerWorkers;
/** Workers as far as the page allows them. */
export declare class AllowedWorkers {
    /** The workers; undefined where a policy of the page refuses them, or their program cannot be had. */
    readonly found: Promise<ViewerWorkers | undefined>;
    /** The same, once it is known. */
    known: ViewerWorkers | undefined;
    private first;
    /** Start a decoder's worker at once: its program comes while the first bytes of a scene do. */
    constructor(workers: ViewerWorkers | undefined);
    /** Take the worker that was started first, where it was not taken yet. */
    takeFirst(): WorkerLike | undefined;
    close(): void;
    private start;
}
