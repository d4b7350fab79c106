/**
 * The matrix that takes positions of a scene with some axes to those of another.
 *
 * @param from - Directions of the scene's +x, +y and +z, such as `RDF` (SPEC 4.2).
 * @param to - Directions of the other's; `RUB`, three.js and PlayCanvas, by default.
 * @returns Nine numbers, row by row, each −1, 0 or 1; a reflection where the one is right-handed and the other is not.
 */
export declare function axesMatrix(from: string, to?: string): number[];
/**
 * The same as a rotation x y z w, for renderers that place objects by one.
 *
 * @throws RangeError where the axes differ by a reflection, which no rotation is.
 */
export declare function axesRotation(from: string, to?: string): [number, number, number, number];
