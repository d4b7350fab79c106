/** Whose textures chunks are decoded to: those of Spark's `ExtSplats`, or of PlayCanvas' uncompressed splats. */
export type TexelLayout = "spark" | "playcanvas";

/** An array for one texture of a renderer, some elements a splat. */
export type TexelArray = Uint32Array<ArrayBuffer> | Uint16Array<ArrayBuffer>;

/** Rows of splats as the textures of a renderer hold them. */
export interface Texels {
  readonly count: number;
  readonly layout: TexelLayout;
  readonly arrays: readonly TexelArray[];
}

/** A texture of a layout: what an array of it has for each splat. */
export interface TexelWidth {
  readonly name: string;
  /** Elements of a splat. */
  readonly width: number;
  /** Bytes of an element: 4 for u32, 2 for half floats. */
  readonly bytes: 2 | 4;
}
