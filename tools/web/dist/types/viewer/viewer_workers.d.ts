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
