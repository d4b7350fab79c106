import { Fields } from "./fields.js";
/** Segment kinds of SPEC 5.2. */
export declare const SegmentKind: {
    readonly head: 1;
    readonly tail: 2;
    readonly shapeCodebook: 3;
    readonly colourBand1: 4;
    readonly colourBand2: 5;
    readonly colourBand3: 6;
    readonly refinement: 7;
    readonly opacities: 8;
    readonly cameras: 128;
    readonly attributes: 129;
    readonly compensation: 130;
    readonly viewTable: 131;
};
/** The rows of one or several segment tables (SPEC 5.3). */
export interface SegmentTable {
    readonly kind: Uint8Array;
    readonly owner: Uint32Array;
    readonly length: Uint32Array;
    readonly crc: Uint32Array;
    /** 16 bytes a row. */
    readonly hash: Uint8Array;
    readonly needs: Uint32Array;
}
/** The rows of one or several chunk tables (SPEC 5.4). */
export interface ChunkTable {
    readonly splats: Uint32Array;
    /** Six numbers a row: minimum then maximum corner. */
    readonly box: Float32Array;
    readonly contribution: Float64Array;
    readonly layer: Uint32Array;
    readonly cell: Uint32Array;
    readonly object: Uint32Array;
    readonly quality: Float32Array;
    /** The chunk is drawn in prefixes of fewer chunks than this; 0 in all (SPEC 5.10). */
    readonly until: Uint32Array;
}
/** Read `segments` of a root or a page. */
export declare function readSegmentTable(fields: Fields): SegmentTable;
/** Read `chunks` of a root or a page. */
export declare function readChunkTable(fields: Fields): ChunkTable;
/** The rows of one table and then of another. */
export declare function joinTables<T extends SegmentTable | ChunkTable>(first: T, second: T): T;
/** A column of u32; bins are not aligned, so each number is read by itself. */
export declare function uint32Column(view: DataView): Uint32Array;
/** A column of f64. */
export declare function float64Column(view: DataView): Float64Array;
