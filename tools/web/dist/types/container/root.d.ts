import { type Pinhole } from "./pinhole.js";
import { type ChunkTable, type SegmentTable } from "./tables.js";
/** What a codebook's rows are (SPEC 5.5). */
export interface CodebookEntry {
    readonly attribute: "shape" | "colour";
    readonly rows: number;
}
/** Types of extra attributes (SPEC 5.7) with the bytes of a value. */
export declare const ATTRIBUTE_TYPES: {
    readonly u1: 1;
    readonly i1: 1;
    readonly u2: 2;
    readonly i2: 2;
    readonly u4: 4;
    readonly i4: 4;
    readonly f4: 4;
    readonly f8: 8;
};
/** An extra attribute that splats carry beside what is drawn of them (SPEC 5.7). */
export interface AttributeEntry {
    readonly name: string;
    readonly type: keyof typeof ATTRIBUTE_TYPES;
    /** Values of a splat where they are an array, 0 where a splat has one value. */
    readonly components: number;
}
/** An index page as the root announces it (SPEC 5.6). */
export interface PageEntry {
    readonly length: number;
    readonly crc: number;
    readonly segments: number;
    readonly chunks: number;
    readonly span: number;
}
/** A level of a scene that is made for pictures of several sizes (SPEC 5.11). */
export interface LevelEntry {
    /** First chunks of the file that make it up. */
    readonly chunks: number;
    /** Its pictures are the full ones divided by this in width and height. */
    readonly scale: number;
}
/** What the root says of the scene (SPEC 4.2). */
export interface SceneInfo {
    readonly writer: string;
    /** Splats of all chunks, those that end counted. */
    readonly splats: number;
    readonly shDegree: number;
    /** Where the means' zero is in the world, scene units. */
    readonly origin: readonly number[];
    /** Directions of +x, +y and +z, such as `RDF`. */
    readonly axes: string;
    readonly colourSpace: "srgb" | "linear";
    /** Variance that a renderer adds to projected covariances, px². */
    readonly kernelPx: number;
    readonly antialiased: boolean;
    /** Minimum then maximum corner of what the splats reach. */
    readonly box: readonly number[];
    readonly firstView: Pinhole | undefined;
    readonly attributes: readonly AttributeEntry[];
    /** Coarsest first; none where the scene has no levels. */
    readonly levels: readonly LevelEntry[];
}
/** The root: the scene, the codebooks, the pages and the root's own tables. */
export interface Root {
    readonly scene: SceneInfo;
    readonly codebooks: readonly CodebookEntry[];
    readonly pages: readonly PageEntry[];
    readonly segments: SegmentTable;
    readonly chunks: ChunkTable;
}
/** Read and check the root's map; the CRC was checked before. */
export declare function readRoot(bytes: Uint8Array): Root;
