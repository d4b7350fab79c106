import type { ByteRange } from "../container/scene_index.js";
import { LinkEstimate } from "./link_estimate.js";
import type { RetryingReader } from "./retrying_reader.js";
/** Receives what requests bring. */
export interface UnitReceiver {
    /** A unit has come whole. */
    came(unit: number, payload: Uint8Array): void;
    /** Units cannot be had. */
    failed(error: unknown, units: readonly number[]): void;
    /** A request has ended. */
    ended(): void;
}
/** Requests of units, which can be stopped and go on later from the byte where they were. */
export declare class UnitRequests {
    private readonly reader;
    /** Where a unit is in what is read. */
    private readonly rangeOf;
    private readonly receiver;
    readonly link: LinkEstimate;
    /** Bytes that have come of units that are not whole. */
    readonly received: Map<number, number>;
    private readonly parts;
    private readonly requests;
    constructor(reader: RetryingReader, 
    /** Where a unit is in what is read. */
    rangeOf: (unit: number) => ByteRange, receiver: UnitReceiver);
    /** Units that are asked for. */
    get underWay(): number[];
    /** Whether one more request may be made: answers share the connection, so that the first would wait for all others. */
    private get hasRoom();
    /**
     * Ask for units, those that lie beside each other together, until as much is under way as keeps the connection busy.
     *
     * @param wanted - In the order in which they are wanted.
     * @param priority - Of `fetch`, of a request whose first unit it is given.
     */
    start(wanted: readonly number[], priority: (unit: number) => RequestPriority): void;
    /**
     * Stop units, and those that were asked for together with one of them; what has come of them stays.
     *
     * @returns How many units were stopped.
     */
    stop(units: readonly number[]): number;
    /** Stop all. */
    close(): void;
    /** Forget what has come of a unit. */
    forget(unit: number): void;
    /** What is still to come of a unit. */
    private readonly rest;
    private run;
    /** Share a part of an answer out among the units that are still to come of it, which lie beside each other. */
    private take;
}
