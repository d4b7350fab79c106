import type { Kernels } from "../kernels/kernels.js";
import { type StoredPlane } from "./planes.js";
/** Attributes of SPEC 6.2. */
export declare const Attribute: {
    readonly means: 1;
    readonly opacities: 2;
    readonly sh0: 3;
    readonly scales: 4;
    readonly quats: 5;
    readonly scaleFactor: 6;
    readonly shape: 7;
    readonly shN: 8;
    readonly sh1: 9;
    readonly sh2: 10;
    readonly sh3: 11;
};
/** Stream kinds of SPEC 6.2. */
export declare const Kind: {
    readonly scalar: 1;
    readonly float: 2;
    readonly quat: 3;
    readonly vq: 4;
    readonly sorted: 5;
    readonly differences: 6;
    readonly swingTwist: 7;
    readonly basis: 8;
    readonly digits: 9;
    readonly bits: 10;
};
/** One stream of a payload: its record, its parameters and its planes. */
export interface StreamRecord {
    readonly attribute: number;
    readonly name: string;
    readonly kind: number;
    readonly components: number;
    /** Whether the rows are escape rows, which a vq stream of the same payload refers to. */
    readonly escape: boolean;
    readonly infinities: boolean;
    readonly rows: number;
    readonly params: DataView;
    readonly planes: readonly StoredPlane[];
}
/** What a payload belongs to: refinements have kinds of their own. */
export type Place = "head" | "tail" | "codebook" | "refinement" | "opacities";
/** The streams of one payload: those that a clause of SPEC 7 names are taken in its order, others are refused. */
export declare class Payload {
    private readonly rows;
    private readonly place;
    private readonly streams;
    /**
     * Copy a payload into the kernels' memory and read its records.
     *
     * @param k - Memory that receives the payload.
     * @param bytes - The payload; its CRC was checked.
     * @param rows - Rows of the chunk or codebook, the most that a stream may have.
     * @param place - What the payload belongs to.
     */
    constructor(k: Kernels, bytes: Uint8Array, rows: number, place: Place);
    /** Whether a stream of an attribute is there and was not taken yet. */
    has(attribute: number, escape?: boolean): boolean;
    /** The stream of an attribute that must be there, one row for each row of the payload. */
    take(attribute: number): StreamRecord;
    /** The escape rows of an attribute, which must be there and be so many. */
    takeEscape(attribute: number, rows: number): StreamRecord;
    private takeRows;
    /** Of a refinement the stream that refines one of the head's, where there is one (SPEC 7.4). */
    takeRefining(head: StreamRecord): StreamRecord | undefined;
    /** Refuse streams that nothing took. */
    finish(): void;
}
/** Refuse parameters of another length than the kind implies. */
export declare function checkParams(stream: StreamRecord, bytes: number): void;
/** Refuse another number of planes than the parameters imply. */
export declare function checkPlanes(stream: StreamRecord, planes: number): void;
