import type { ByteSource } from "../loader/byte_source.js";
import type { Meter } from "./meter.js";
import type { FeedHost, Prefix, SceneFeed } from "./scene_feed.js";
import type { AllowedWorkers } from "./viewer_workers.js";
/** Fills a layer from a PLY of 3DGS training. */
export declare class PlyFeed implements SceneFeed {
    private readonly source;
    private readonly meter;
    private readonly workers;
    private readonly mostSplats;
    readonly progressive = false;
    readonly hasFirstView = false;
    private layer;
    /**
     * @param source - A URL or a file.
     * @param meter - Says how fast its bytes may come, and counts them.
     * @param workers - Where the page allows none, rows are read on the caller's thread, a block at a time.
     * @param mostSplats - Rows beyond are not read.
     */
    constructor(source: string | Blob, meter: Meter, workers: AllowedWorkers, mostSplats: number);
    run(host: FeedHost, signal: AbortSignal): Promise<void>;
    prefixes(): Prefix[];
    show(): void;
    drawLevel(): undefined;
    work(): boolean;
}
/** The source where it is a PLY: by the name of a URL, by the first bytes of a file. */
export declare function plyOf(source: string | Blob | ByteSource): Promise<string | Blob | undefined>;
