/** The opacities of a scene's splats at its levels (SPEC 5.11), and those of two adjacent levels as shaders mix them. */
export declare class LevelOpacities {
    private readonly chunks;
    /**
     * Note what has come of a chunk.
     *
     * @param drawnBy - Levels that draw the chunk, in their order; none for a chunk that is there for the first seconds alone.
     * @param opacities - Level by level from the first of these on.
     */
    put(chunk: number, drawnBy: readonly number[], opacities: readonly (Uint8Array | undefined)[]): void;
    /** Forget all chunks. */
    clear(): void;
    /** The chunks of which something has come. */
    get known(): Iterable<number>;
    /**
     * A word for each splat of a chunk: its opacity at a level in the lowest byte, at the next level in the byte above, in 1/255.
     *
     * @param factor - What opacities are multiplied by, 0 to 1.
     */
    words(chunk: number, level: number, factor?: number): Uint32Array;
}
