import type { Shifts } from "../container/compensation.js";
import { type PackedSplats } from "../scene/packed_splats.js";
/**
 * The textures of a scene: splats, what compensation adds to them, SH bands, the order in which they are drawn and, where
 * the scene has levels, their opacities at two adjacent ones.
 */
export declare class SplatTextures {
    private readonly splats;
    private readonly shifts;
    private readonly order;
    private readonly bands;
    private readonly levels;
    /** Rows from the first on that hold something. */
    private written;
    constructor(rows: number, degree: number, hasLevels: boolean);
    private get all();
    /** Make the textures, for the first time or because the graphics memory was lost; rows that were written are uploaded anew. */
    allocate(gl: WebGL2RenderingContext): void;
    /** Put a chunk's rows where they belong. */
    write(packed: PackedSplats, firstRow: number): void;
    /** Make rows transparent: what has no opacity is not drawn. */
    clear(firstRow: number, count: number): void;
    /** Note the opacities of rows at two adjacent levels, as `LevelOpacities` gives them. */
    writeLevels(words: Uint32Array, firstRow: number): void;
    /** Note what compensation adds to rows. */
    writeShifts(firstRow: number, count: number, shifts: Shifts | undefined): void;
    /** Set the order in which the first rows are drawn. */
    writeOrder(order: Uint32Array, rows: number): void;
    /** Upload about as many bytes of what has changed as go to the graphics without waiting for them; returns whether that was all. */
    upload(gl: WebGL2RenderingContext): boolean;
    /** Bind all to units: splats, order, shifts, then the bands and the opacities of levels. */
    bind(gl: WebGL2RenderingContext): void;
    delete(gl: WebGL2RenderingContext): void;
}
