import type { ByteSource } from "../loader/byte_source.js";
import type { Pose } from "../schedule/poses.js";
import { type Meter } from "./meter.js";
import type { FeedHost, Prefix, SceneFeed } from "./scene_feed.js";
import type { AllowedWorkers } from "./viewer_workers.js";
/** What is fetched first: what the file has first, or what the view shows; by the view where the file was cut for that. */
export type FetchOrder = "file" | "view" | undefined;
/** Fills a layer from a COGS file while it is fetched. */
export declare class CogsFeed implements SceneFeed {
    private readonly source;
    private readonly meter;
    private readonly workers;
    private readonly mostSplats;
    private readonly order;
    readonly progressive = true;
    private scene;
    private layer;
    private host;
    /** First row and rows of the chunks that have come. */
    private readonly rowsOf;
    private splats;
    private prefix;
    /** What could not be had or used, first of all. */
    private damage;
    /** Chunks that are shown with what they add for missing ones. */
    private readonly shifted;
    /** Prefix that compensation is for, and chunks that still wait for it. */
    private compensatedFor;
    private waiting;
    private shown;
    /** Chunks that end, as they came. */
    private readonly temporary;
    private readonly ending;
    private readonly opacities;
    /** The coarser one of the two levels whose opacities the layer has. */
    private coarser;
    /** Where chunks are chosen by the view: who chooses them, and the layer that they are in. */
    private visit;
    private visited;
    private pose;
    /**
     * @param source - A URL, a file or another source.
     * @param meter - Counts its bytes.
     * @param workers - Where the page allows none, chunks are decoded on the caller's thread, one at a time.
     * @param mostSplats - Chunks beyond are not fetched; where they are chosen by the view, others make room for them.
     */
    constructor(source: string | Blob | ByteSource, meter: Meter, workers: AllowedWorkers, mostSplats: number, order: FetchOrder);
    get hasFirstView(): boolean;
    run(host: FeedHost, signal: AbortSignal): Promise<void>;
    /** Begin anew, with nothing shown. */
    private forget;
    private readonly service;
    private stream;
    private streamAll;
    /** Whether chunks are chosen by the view: those of levels and those that end are drawn in the order of the file. */
    private isVisited;
    private beVisited;
    look(pose: Pose): void;
    limit(splats: number): boolean;
    work(milliseconds: number): boolean;
    drawLevel(focal: number, chosen: number | undefined): number | undefined;
    /** Chunks of the prefix that is drawn. */
    private get drawnPrefix();
    private writeLevels;
    prefixes(count: number): Prefix[];
    show(prefix: Prefix | undefined): void;
    /** Draw a chunk that ends with its opacities times a factor. */
    private paint;
    private take;
    private report;
}
