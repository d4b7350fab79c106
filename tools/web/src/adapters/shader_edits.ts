/**
 * Replace parts of a shader.
 *
 * @param edits - Old and new text of each part, replaced everywhere.
 * @returns undefined where an old text is missing, as in other versions of a renderer.
 */
export function editShader(shader: string, edits: readonly (readonly [string, string])[]): string | undefined {
  let text = shader;
  for (const [before, after] of edits) {
    if (!text.includes(before)) return undefined;
    text = text.replaceAll(before, after);
  }
  return text;
}

/** Return a number as a GLSL literal. */
export function glslFloat(value: number): string {
  return Number.isInteger(value) ? `${value}.0` : String(value);
}
