import type { Shifts } from "../container/compensation.js";
import { PLAYCANVAS_WIDTHS, packPlayCanvas, packPlayCanvasBands, shiftPlayCanvas } from "./playcanvas_texels.js";
import { packSpark, packSparkBands, SPARK_WIDTHS, shiftSpark } from "./spark_texels.js";
import type { ShRows, Splats } from "./splats.js";
import type { TexelArray, TexelLayout, Texels, TexelWidth } from "./texel_layouts.js";

/** Return the textures of a layout that an SH degree needs, in the order of the arrays. */
export function texelWidths(layout: TexelLayout, degree: number): readonly TexelWidth[] {
  const all = layout === "spark" ? SPARK_WIDTHS : PLAYCANVAS_WIDTHS;
  return all[degree]!;
}

/** Make zeroed arrays of a layout; rows of zeros are not drawn. */
export function makeTexelArrays(layout: TexelLayout, degree: number, splats: number): TexelArray[] {
  return makeArrays(texelWidths(layout, degree), splats);
}

function makeArrays(widths: readonly TexelWidth[], splats: number): TexelArray[] {
  return widths.map(({ width, bytes }) => {
    return bytes === 4 ? new Uint32Array(width * splats) : new Uint16Array(width * splats);
  });
}

/** Pack splats into the textures of a renderer, within the tolerances of SPEC 8.6. */
export function packTexels(layout: TexelLayout, splats: Splats): Texels {
  const arrays = makeTexelArrays(layout, splats.shDegree, splats.count);
  if (layout === "spark") packSpark(splats, arrays as Uint32Array<ArrayBuffer>[]);
  else packPlayCanvas(splats, arrays);
  return { count: splats.count, layout, arrays };
}

/** Return the number of textures without coefficients above DC, which are the first ones of a layout. */
export function headTextures(layout: TexelLayout): number {
  return texelWidths(layout, 0).length;
}

/**
 * Pack coefficients above DC into the textures after the first ones.
 *
 * @param rows - Coefficients of a degree above 0.
 */
export function packBandTexels(layout: TexelLayout, rows: ShRows): TexelArray[] {
  const bands = makeArrays(texelWidths(layout, rows.shDegree).slice(headTextures(layout)), rows.count);
  const pack = layout === "spark" ? packSparkBands : packPlayCanvasBands;
  pack(rows, bands as Uint32Array<ArrayBuffer>[]);
  return bands;
}

/**
 * Write rows into the arrays of a whole scene, with their shifts of compensation (SPEC 8.5).
 *
 * @param shifts - Shifts to add, if any.
 * @param first - Row of the scene of the first row.
 */
export function writeTexels(
  texels: Texels,
  shifts: Shifts | undefined,
  targets: readonly TexelArray[],
  first: number,
): void {
  const { arrays, count, layout } = texels;
  arrays.forEach((array, i) => {
    targets[i]!.set(array, (array.length / count) * first);
  });
  if (shifts !== undefined) (layout === "spark" ? shiftSpark : shiftPlayCanvas)(texels, shifts, targets, first);
}
