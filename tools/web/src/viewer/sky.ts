import type { SkyPass } from "./renderer.js";
import { WHOLE_PICTURE_SHADER } from "./shaders.js";

/** Reads an equirectangular picture in the direction of each pixel (SPEC 5.14). */
const SKY_SHADER = `#version 300 es
precision highp float;
uniform sampler2D picture;
uniform mat3 rotation;  // camera to picture
uniform vec2 focal;     // px
uniform vec2 middle;    // px
uniform float lod;
uniform bool linear;
out vec4 pixel;

void main() {
  vec2 at = (gl_FragCoord.xy - middle) * vec2(1.0, -1.0) / focal;
  vec3 d = normalize(rotation * vec3(at, 1.0));
  vec2 uv = vec2(0.5 + atan(d.x, d.z) / 6.28318531, 0.5 + asin(clamp(d.y, -1.0, 1.0)) / 3.14159265);
  vec3 c = textureLod(picture, uv, lod).rgb;
  pixel = vec4(linear ? mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045))) : c, 1.0);
}
`;

/** An equirectangular picture behind the splats. */
export class Sky {
  private program: WebGLProgram | undefined;
  private texture: WebGLTexture | undefined;
  /** From the space of the means to the picture's right, down and middle, row by row. */
  private readonly rotation: readonly number[];

  /**
   * @param rotation - Rotation that the description states; undefined for the axes of the scene.
   * @param axes - Axes of the scene, such as `RDF`.
   */
  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly picture: ImageBitmap,
    rotation: readonly number[] | undefined,
    axes: string,
  ) {
    this.rotation = rotation ?? rightDownFront(axes);
  }

  /** Draw the sky over the whole render target. */
  readonly draw: SkyPass = ({ rotation, focal, principal = [0, 0] }, width, height, linear) => {
    const { gl } = this;
    // Lost graphics take both with them.
    if (this.program === undefined || !gl.isProgram(this.program)) this.build();
    const program = this.program!;
    gl.useProgram(program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture!);
    const uniform = (name: string): WebGLUniformLocation | null => gl.getUniformLocation(program, name);
    // Camera to means is the transpose of the view's rotation.
    const s = this.rotation;
    const combined = [0, 3, 6].flatMap((row) =>
      [0, 3, 6].map((axis) => [0, 1, 2].reduce((sum, i) => sum + s[row + i]! * rotation[axis + i]!, 0)),
    );
    gl.uniformMatrix3fv(uniform("rotation"), true, combined);
    gl.uniform2f(uniform("focal"), focal[0], focal[1]);
    gl.uniform2f(uniform("middle"), width / 2 + principal[0], height / 2 - principal[1]);
    gl.uniform1f(uniform("lod"), Math.max(0, Math.log2(this.picture.width / (2 * Math.PI * focal[0]))));
    gl.uniform1i(uniform("picture"), 0);
    gl.uniform1i(uniform("linear"), Number(linear));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  };

  close(): void {
    this.gl.deleteProgram(this.program ?? null);
    this.gl.deleteTexture(this.texture ?? null);
    this.picture.close();
  }

  private build(): void {
    const { gl, picture } = this;
    const program = gl.createProgram();
    for (const [type, text] of [
      [gl.VERTEX_SHADER, WHOLE_PICTURE_SHADER],
      [gl.FRAGMENT_SHADER, SKY_SHADER],
    ] as const) {
      const shader = gl.createShader(type)!;
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    this.program = program;
    this.texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, picture);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }
}

/** Return the directions right, down and front of axes such as `RDF`, row by row. */
export function rightDownFront(axes: string): number[] {
  const opposite = { R: "L", D: "U", F: "B" };
  return (["R", "D", "F"] as const).flatMap((name) =>
    [...axes].map((axis) => (axis === name ? 1 : axis === opposite[name] ? -1 : 0)),
  );
}
