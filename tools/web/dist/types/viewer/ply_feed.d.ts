import type { FeedHost, Prefix, SceneFeed } from "./scene_feed.js";
import type { ViewerWorkers } from "./viewer_workers.js";
/** Fills a layer from a PLY of 3DGS training. */
export declare class PlyFeed implements SceneFeed {
    private readonly source;
    private readonly workers;
    private readonly mostSplats;
    readonly progressive = false;
    readonly hasFirstView = false;
    private layer;
    /**
     * @param source - A URL or a file.
     * @param workers - Makes the worker that reads; undefined reads on the caller's thread.
     * @param mostSplats - Rows beyond are not read.
     */
    constructor(source: string | Blob, workers: ViewerWorkers | undefined, mostSplats: number);
    run(host: FeedHost, signal: AbortSignal): Promise<void>;
    prefixes(): Prefix[];
    show(): void;
    work(): boolean;
}
