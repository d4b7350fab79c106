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

/** Shader text of the area of the pixel of training at a place in the space of the camera (SPEC 8.7). */
export const TRAINING_AREA = `uniform vec4 trainingPixel; uniform float trainingRest;
float trainingArea(vec3 place) {
  vec3 aside = place - trainingPixel.xyz;
  return trainingPixel.w * dot(aside, aside) + trainingRest;
}`;
