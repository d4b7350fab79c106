/** What a connection brings, by what has come lately (docs/streaming.md, 11). */
export declare class LinkEstimate {
    bytesPerSecond: number;
    private readonly parts;
    private shortest;
    /** Seconds from a request to its first byte: the shortest time so far, for longer ones waited behind other answers. */
    get latency(): number;
    /** Note how long a request had waited when its first byte came. */
    answered(seconds: number): void;
    /** Note bytes that have come at a time. */
    came(bytes: number, seconds: number): void;
    /** Note that nothing is under way, so that the pause does not count. */
    rest(): void;
}
