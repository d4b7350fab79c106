import { type PackedSplats } from "../scene/packed_splats.js";
/** A texture of unsigned integers, one texel a splat, with a copy in memory from which changed rows are uploaded. */
declare class RowTexture {
    private readonly gl;
    private readonly channels;
    readonly words: Uint32Array;
    private readonly texture;
    private first;
    private end;
    constructor(gl: WebGL2RenderingContext, channels: 1 | 2 | 4, rows: number);
    /** Note that rows have changed. */
    touch(first: number, count: number): void;
    /** Bind to a unit, after uploading the lines that have changed. */
    bind(unit: number): void;
    delete(): void;
}
/** The textures of a scene: splats, SH bands and the order in which they are drawn. */
export declare class SplatTextures {
    readonly splats: RowTexture;
    readonly order: RowTexture;
    readonly bands: RowTexture[];
    constructor(gl: WebGL2RenderingContext, rows: number, degree: number);
    /** Put a chunk's rows where they belong. */
    write(packed: PackedSplats, firstRow: number): void;
    delete(): void;
}
export {};
