import type { RetryingReader } from "./retrying_reader.js";
/** The first bytes of a file, held for all streams of a scene; the first of them are used before the last have come. */
export declare class Beginning {
    private readonly reader;
    /** Bytes to ask for; fewer come where the file is shorter. */
    readonly length: number;
    private readonly bytes;
    private received;
    /** Nothing more will come: all is there, or the file is shorter. */
    private ended;
    /** Length of the whole file, where the source says so. */
    total: number | undefined;
    /** Whether the source gives the whole file whatever it is asked for. */
    sequential: boolean;
    private filling;
    private abort;
    private wake;
    private arrival;
    constructor(reader: RetryingReader, 
    /** Bytes to ask for; fewer come where the file is shorter. */
    length: number);
    /** The bytes that are there. */
    get here(): Uint8Array;
    /** Whether a range will be here when the request has ended. */
    holds(end: number): boolean;
    /** Wait until so many bytes are here, or the file has ended before; they are asked for where nobody has yet. */
    upTo(length: number, signal: AbortSignal | undefined): Promise<void>;
    /** End the request; whoever still waits for bytes asks for the rest again. */
    stop(): void;
    private nextArrival;
    private fill;
}
