/**
 * Put other lines in the place of a shader's own.
 *
 * @param edits - What stands there, and what takes its place, everywhere in the text.
 * @returns The shader; undefined where one of the lines is missing, as it may be in other versions of a renderer.
 */
export function editShader(shader: string, edits: readonly (readonly [string, string])[]): string | undefined {
  let text = shader;
  for (const [before, after] of edits) {
    if (!text.includes(before)) return undefined;
    text = text.replaceAll(before, after);
  }
  return text;
}

/** A number as GLSL writes it. */
export function glslFloat(value: number): string {
  return Number.isInteger(value) ? `${value}.0` : String(value);
}
