/**
 * Put other lines in the place of a shader's own.
 *
 * @param edits - What stands there, and what takes its place, everywhere in the text.
 * @returns The shader; undefined where one of the lines is missing, as it may be in other versions of a renderer.
 */
export declare function editShader(shader: string, edits: readonly (readonly [string, string])[]): string | undefined;
/** A number as GLSL writes it. */
export declare function glslFloat(value: number): string;
