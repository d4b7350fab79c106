import type { PackedSplats } from "../scene/packed_splats.js";

/**
 * Words of splats as the shaders read them, row by row.
 *
 * The shader subtracts the camera's position from the float32 means before it rotates them: half floats would be pixels
 * off some metres from the origin.
 */
export interface ShaderRows {
  /** Mean x, y, z as float32; word 0 of `PackedSplats`. */
  readonly splats: Uint32Array;
  /** Words 2 and 3 of `PackedSplats`. */
  readonly shapes: Uint32Array;
}

/** Write packed splats from a row on. */
export function writeShaderRows(
  { count, words, means }: Pick<PackedSplats, "count" | "words" | "means">,
  { splats, shapes }: ShaderRows,
  firstRow: number,
): void {
  const bits = new Uint32Array(means.buffer, means.byteOffset, means.length);
  for (let i = 0, row = firstRow; i < count; i++, row++) {
    splats[4 * row] = bits[3 * i]!;
    splats[4 * row + 1] = bits[3 * i + 1]!;
    splats[4 * row + 2] = bits[3 * i + 2]!;
    splats[4 * row + 3] = words[4 * i]!;
    shapes[2 * row] = words[4 * i + 2]!;
    shapes[2 * row + 1] = words[4 * i + 3]!;
  }
}

/** Read the means of splats from a row on, as many as `means` has room for. */
export function readMeans({ splats }: ShaderRows, firstRow: number, means: Float32Array): void {
  const floats = new Float32Array(splats.buffer, splats.byteOffset, splats.length);
  for (let i = 0; i < means.length; i++) means[i] = floats[4 * (firstRow + Math.floor(i / 3)) + (i % 3)]!;
}

/** Camera of a picture in the uniforms of the shader, both in the space of the means. */
export interface CameraUniforms {
  /** Position of the camera, rounded to float32. */
  readonly cameraPosition: readonly number[];
  /** Place of that position in the space of the camera: the rounding error. */
  readonly translation: readonly number[];
}

/**
 * Return the uniforms of a camera: differences of float32 means and a float32 position near them are exact, so that
 * pictures are as sharp at any distance from the origin.
 *
 * @param rotation - World to camera, row by row.
 * @param translation - Place of the origin in the space of the camera.
 * @param position - Position of the camera.
 */
export function cameraUniforms(
  rotation: readonly number[],
  translation: readonly number[],
  position: readonly number[],
): CameraUniforms {
  const rounded = position.map(Math.fround);
  return {
    cameraPosition: rounded,
    translation: translation.map((value, row) =>
      rounded.reduce((sum, x, i) => sum + rotation[3 * row + i]! * x, value),
    ),
  };
}
