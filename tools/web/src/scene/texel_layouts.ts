/** Renderer whose textures chunks are decoded to: Spark's `ExtSplats`, or PlayCanvas' uncompressed splats. */
export type TexelLayout = "spark" | "playcanvas";

/** Array for one texture of a renderer, with a fixed number of elements per splat. */
export type TexelArray = Uint32Array<ArrayBuffer> | Uint16Array<ArrayBuffer>;

/** Rows of splats in the texture layout of a renderer. */
export interface Texels {
  readonly count: number;
  readonly layout: TexelLayout;
  readonly arrays: readonly TexelArray[];
}

/** A texture of a layout: the elements that each splat takes. */
export interface TexelWidth {
  readonly name: string;
  /** Elements per splat. */
  readonly width: number;
  /** Bytes per element: 4 for u32, 2 for half floats. */
  readonly bytes: 2 | 4;
}
