import { shiftPacked, packedMeans, type PackedSplats, type PackRanges, DEFAULT_RANGES } from "../scene/packed_splats.js";
import type { Shifts } from "../container/compensation.js";
import type { SceneInfo } from "../container/root.js";
import { sortByDepth } from "./depth_order.js";
import { FRAGMENT_SHADER, QUADS_PER_INSTANCE, VERTEX_SHADER } from "./shaders.js";
import { SplatTextures } from "./splat_textures.js";

/** Where a picture is taken from: x_camera = R·x + t in the space of the means, x right, y down, z forward. */
export interface View {
  /** R, row by row. */
  readonly rotation: readonly number[];
  readonly translation: readonly number[];
  /** Focal lengths, px of the canvas. */
  readonly focal: readonly [number, number];
}

/** Draws packed splats with WebGL 2, by the rules of SPEC 8.7. */
export class SplatRenderer {
  private readonly gl: WebGL2RenderingContext;
  private readonly program: WebGLProgram;
  private readonly textures: SplatTextures;
  private readonly means: Float32Array;
  private readonly ranges: PackRanges;
  private rows = 0;
  /** Direction of view of the last sort; undefined where rows have come since. */
  private sortedFor: readonly number[] | undefined;

  /**
   * @param canvas - Where pictures are drawn.
   * @param scene - What the root says; textures are made for all of its splats.
   * @param degree - SH degree that is drawn.
   */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly scene: SceneInfo,
    private readonly degree: number,
    ranges: Partial<PackRanges> = {},
  ) {
    const gl = canvas.getContext("webgl2", { antialias: false, premultipliedAlpha: true, preserveDrawingBuffer: true });
    if (gl === null) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.ranges = { ...DEFAULT_RANGES, ...ranges };
    this.program = link(gl);
    this.textures = new SplatTextures(gl, scene.splats, degree);
    this.means = new Float32Array(3 * scene.splats);
    makeQuads(gl);
  }

  /** Put a chunk's rows where they belong; `shifts` are those of compensation. */
  write(packed: PackedSplats, firstRow: number, shifts?: Shifts): void {
    this.textures.write(packed, firstRow);
    if (shifts) shiftPacked(packed.words, shifts, this.textures.splats.words, 4 * firstRow);
    this.means.set(packedMeans(packed), 3 * firstRow);
    this.rows = Math.max(this.rows, firstRow + packed.count);
    this.sortedFor = undefined;
  }

  /** Draw a picture. */
  draw(view: View): void {
    const { gl, canvas, program, scene, ranges, textures } = this;
    const { rotation: r, translation: t } = view;
    this.sort(r.slice(6, 9));
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(program);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const at = (name: string) => gl.getUniformLocation(program, name);
    gl.uniform1i(at("count"), this.rows);
    gl.uniform1i(at("degree"), this.degree);
    gl.uniformMatrix3fv(at("rotation"), true, r as number[]);
    gl.uniform3f(at("translation"), t[0]!, t[1]!, t[2]!);
    const position = [0, 1, 2].map((i) => -(r[i]! * t[0]! + r[3 + i]! * t[1]! + r[6 + i]! * t[2]!));
    gl.uniform3f(at("cameraPosition"), position[0]!, position[1]!, position[2]!);
    gl.uniform2f(at("focal"), view.focal[0], view.focal[1]);
    gl.uniform2f(at("viewport"), canvas.width, canvas.height);
    gl.uniform1f(at("kernel"), scene.kernelPx);
    gl.uniform1i(at("antialiased"), scene.antialiased ? 1 : 0);
    gl.uniform2f(at("rgbRange"), ranges.rgbMin, ranges.rgbMax);
    gl.uniform1f(at("shRange"), ranges.shRange);
    const samplers = [textures.splats, textures.order, ...textures.bands];
    samplers.forEach((texture, unit) => texture.bind(unit));
    ["splats", "order", "sh1", "sh2", "sh3"].forEach((name, unit) => gl.uniform1i(at(name), unit < samplers.length ? unit : 0));
    const instances = Math.ceil(this.rows / QUADS_PER_INSTANCE);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * QUADS_PER_INSTANCE, gl.UNSIGNED_SHORT, 0, instances);
  }

  /** Give back what the graphics memory holds. */
  delete(): void {
    this.textures.delete();
    this.gl.deleteProgram(this.program);
  }

  private sort(forward: readonly number[]): void {
    const before = this.sortedFor;
    if (before !== undefined && before.every((value, i) => Math.abs(value - forward[i]!) < 1e-3)) return;
    sortByDepth(this.means, this.rows, forward, this.textures.order.words);
    this.textures.order.touch(0, this.rows);
    this.sortedFor = forward;
  }
}

function link(gl: WebGL2RenderingContext): WebGLProgram {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX_SHADER], [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]] as const) {
    const shader = gl.createShader(type)!;
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "no shader");
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) ?? "no program");
  return program;
}

/** The indices of one instance's quads; the shader makes corners of the numbers of vertices. */
function makeQuads(gl: WebGL2RenderingContext): void {
  const indices = new Uint16Array(6 * QUADS_PER_INSTANCE);
  for (let quad = 0; quad < QUADS_PER_INSTANCE; quad++) {
    indices.set([0, 1, 2, 2, 1, 3].map((corner) => 4 * quad + corner), 6 * quad);
  }
  gl.bindVertexArray(gl.createVertexArray());
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
}
