/** Directions of +x, +y and +z in renderers with OpenGL's axes: right, up, back. */
const OPENGL = "RUB";
const OPPOSITE: Readonly<Record<string, string>> = { R: "L", L: "R", U: "D", D: "U", F: "B", B: "F" };

/**
 * Return the matrix from a scene's axes to a renderer's axes.
 *
 * @param from - Directions of the scene's +x, +y and +z, for example `RDF` (SPEC 4.2).
 * @param to - Directions of the renderer's axes; by default `RUB`, of three.js and PlayCanvas.
 * @returns Nine numbers, row by row, each −1, 0 or 1; a reflection where the handedness differs.
 */
export function axesMatrix(from: string, to = OPENGL): number[] {
  return [...to].flatMap((direction) =>
    [...from].map((letter) => (letter === direction ? 1 : letter === OPPOSITE[direction] ? -1 : 0)),
  );
}

/**
 * Return the rotation x y z w from a scene's axes to a renderer's axes.
 *
 * @throws RangeError where the axes differ by a reflection.
 */
export function axesRotation(from: string, to = OPENGL): [number, number, number, number] {
  const m = axesMatrix(from, to) as [number, number, number, number, number, number, number, number, number];
  const determinant =
    m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) + m[2] * (m[3] * m[7] - m[4] * m[6]);
  if (determinant < 0) throw new RangeError(`axes ${from} are a reflection of ${to}`);
  // The component of largest magnitude comes first, so that no division is by 0.
  const squares = [1 + m[0] - m[4] - m[8], 1 - m[0] + m[4] - m[8], 1 - m[0] - m[4] + m[8], 1 + m[0] + m[4] + m[8]];
  const largest = squares.indexOf(Math.max(...squares));
  const r = Math.sqrt(squares[largest]!);
  const s = 0.5 / r;
  switch (largest) {
    case 0:
      return [r / 2, (m[1] + m[3]) * s, (m[2] + m[6]) * s, (m[7] - m[5]) * s];
    case 1:
      return [(m[1] + m[3]) * s, r / 2, (m[5] + m[7]) * s, (m[2] - m[6]) * s];
    case 2:
      return [(m[2] + m[6]) * s, (m[5] + m[7]) * s, r / 2, (m[3] - m[1]) * s];
    default:
      return [(m[7] - m[5]) * s, (m[2] - m[6]) * s, (m[3] - m[1]) * s, r / 2];
  }
}
