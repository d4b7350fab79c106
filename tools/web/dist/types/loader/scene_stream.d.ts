import type { SceneIndex, ScenePlaces } from "../container/scene_index.js";
import type { Beginning } from "./beginning.js";
import type { PrefixCompensation } from "../scene/prefix_compensation.js";
import type { ChunkService } from "../workers/decode_task.js";
import { type ChunkUpdate, type StreamOptions } from "./stream_options.js";
import type { RetryingReader } from "./retrying_reader.js";
/** What a stream reads from; shared by all streams of a scene. */
export interface StreamSource {
    readonly index: SceneIndex;
    /** Where segments are in what is read. */
    readonly places: ScenePlaces;
    /** Whether parts can be asked for; else the source gives the whole file whatever it is asked for. */
    readonly answersRanges: boolean;
    readonly reader: RetryingReader;
    /** What the first request brings, as it comes. */
    readonly beginning: Beginning;
    readonly compensation: PrefixCompensation;
    /** Read index pages until so many are known. */
    readPages(count: number): Promise<void>;
}
/** One run through a scene: what is asked for, what has come, and what waits to be taken. */
export declare class SceneStream {
    private readonly source;
    private readonly options;
    private readonly index;
    private readonly abort;
    private readonly queue;
    private readonly waiting;
    /** Segments to ask for, in the order in which they are wanted. */
    private wanted;
    private readonly asked;
    /** Chunks that were given, and how many of them from the first of the file on. */
    private readonly given;
    /** Chunks that are not asked for because they end, or the level does not draw them. */
    private readonly leftOut;
    private prefix;
    private requests;
    /** Segments that the first request is still to bring. */
    private waits;
    private requestBytes;
    private budget;
    private splatBudget;
    private plannedChunks;
    private pagesDone;
    private failure;
    private wake;
    private readonly degree;
    private readonly rowBytes;
    constructor(source: StreamSource, service: ChunkService, options: StreamOptions);
    /** Updates until every chunk has been given. */
    updates(): AsyncGenerator<ChunkUpdate, void, undefined>;
    /** End all requests. */
    stop(): void;
    private readonly onAbort;
    private done;
    private stopWith;
    /** Read the index pages, one after the other; chunks are planned as their pages come. */
    private readPages;
    /** Put the segments of chunks that are newly known among those that are wanted. */
    private plan;
    /** Whether a chunk is drawn at the level that is wanted; notes those that are not. */
    private isWanted;
    private byPriority;
    private endOf;
    /** Accept segments that the first request has brought or brings, one after the other, and let the page do other things between them. */
    private acceptBeginning;
    /** Make requests while there is something to ask for and the caller keeps up. */
    private ask;
    /** One request for all that is wanted, in file order, from a source that does not answer ranges. */
    private wholeRest;
    private readonly rangeOf;
    private run;
    /** Go on without segments that did not come, or end where no others would come either. */
    private lose;
    /** Check a segment's CRC and hand it on; what is damaged is asked for once more, around caches. */
    private accept;
    private take;
    private fetchAgain;
    /** Report what cannot be had; without a listener the stream ends with the error. */
    private damage;
}
