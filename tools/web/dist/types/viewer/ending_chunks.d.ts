/** Chunks that are there for the first seconds alone (SPEC 5.10): each fades when it has ended. */
export declare class EndingChunks {
    private readonly isDrawn;
    private readonly paint;
    private readonly chunks;
    /**
     * @param isDrawn - Whether a prefix draws a chunk.
     * @param paint - Draws a chunk with its opacities times a factor, 0 to 1.
     */
    constructor(isDrawn: (chunk: number, prefix: number) => boolean, paint: (chunk: number, factor: number) => void);
    /** Note that a chunk has come, for the first time or with more, and stands in the picture with all its opacity. */
    put(chunk: number, prefix: number): void;
    /**
     * Draw what a prefix draws.
     *
     * @param fadesFrom - When what has ended begins to fade; undefined to leave it out at once.
     */
    show(prefix: number, fadesFrom: number | undefined): void;
    /** Fade on; returns whether there is something left that fades. */
    work(now: number): boolean;
    clear(): void;
}
