import type { Viewpoint } from "../container/root.js";
import { movedCapture, trainingPixel } from "../scene/training_pixel.js";
import { cameraUniforms } from "./shader_rows.js";
import {
  COMPOSITE_SHADER,
  FRAGMENT_SHADER,
  SPLATS_PER_INSTANCE,
  VERTEX_SHADER,
  WHOLE_PICTURE_SHADER,
} from "./shaders.js";
import type { LayerScene, SplatLayer } from "./splat_layer.js";

/** Camera of a picture: x_camera = R·x + t in the space of the means, x right, y down, z forward. */
export interface View {
  /** R, row by row. */
  readonly rotation: readonly number[];
  readonly translation: readonly number[];
  /** Focal lengths, pixels of the canvas. */
  readonly focal: readonly [number, number];
  /** Principal point from the middle of the picture, right and down, pixels; the middle by default. */
  readonly principal?: readonly [number, number];
}

/** Framebuffer and rectangle for the picture of one eye, in place of the canvas. */
export interface EyeTarget {
  readonly framebuffer: WebGLFramebuffer | null;
  /** Lower left corner and size, pixels. */
  readonly x: number;
  readonly y: number;
  readonly width: number;
  readonly height: number;
  /** Direction that orders the splats of both eyes. */
  readonly forward: readonly number[];
}

/** Draws what is behind the splats over the render target: for a view, its size in px, and whether colours are linear. */
export type SkyPass = (view: View, width: number, height: number, linear: boolean) => void;

/** Options of a picture. */
export interface PictureOptions {
  /** Colour behind the splats: R, G, B and opacity from 0 to 1, display-encoded. */
  readonly background: readonly [number, number, number, number];
  /** Highest SH degree drawn. */
  readonly degree: number;
  /** Strength with which holes between splats take the surrounding colour, 0 to 1. */
  readonly fill: number;
  /** Position of the divide, as a share of the width from the left. */
  readonly divide: number;
  readonly sky?: SkyPass | undefined;
}

/** Draws packed splats with WebGL 2, by the rules of SPEC 8.7. */
export class SplatRenderer {
  readonly gl: WebGL2RenderingContext;
  private splats: Program;
  private composite: Program;
  private target: Target;

  /** @throws NoWebGlError where the browser has no WebGL 2. */
  constructor(private readonly canvas: HTMLCanvasElement) {
    const gl = canvas.getContext("webgl2", {
      alpha: true,
      antialias: false,
      depth: false,
      premultipliedAlpha: true,
      preserveDrawingBuffer: true,
    });
    if (gl === null) throw new NoWebGlError("this browser has no WebGL 2");
    this.gl = gl;
    [this.splats, this.composite, this.target] = this.build();
  }

  /**
   * Whether the programs are built, which many browsers do in parallel with the page.
   *
   * @throws NoWebGlError where they cannot be built.
   */
  get isReady(): boolean {
    return this.splats.isReady && this.composite.isReady;
  }

  /** Make programs and buffers again after the WebGL context was lost. */
  restore(): void {
    [this.splats, this.composite, this.target] = this.build();
  }

  /** Set the size of pictures, pixels. */
  resize(width: number, height: number): void {
    const { canvas } = this;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    this.target.resize(width, height);
  }

  /**
   * Draw a picture.
   *
   * @param view - Camera, with a translation relative to its origin in the world.
   * @param layers - The scene and, in a comparison, the second one, left of the divide.
   * @param eye - Where to draw in place of the canvas.
   * @returns Whether the picture shows all rows received.
   */
  draw(
    view: View & { readonly origin: readonly number[] },
    layers: readonly SplatLayer[],
    options: PictureOptions,
    eye?: EyeTarget,
  ): boolean {
    const { gl, composite, target } = this;
    const { width, height } = eye ?? this.canvas;
    if (eye !== undefined) target.resize(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.disable(gl.SCISSOR_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT);
    options.sky?.(view, width, height, layers[0]?.scene.linear ?? false);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const divide = layers.length > 1 ? Math.round(width * options.divide) : 0;
    if (layers.length > 1) gl.enable(gl.SCISSOR_TEST);
    const whole = layers.map((layer, i) => {
      if (i === 0) gl.scissor(divide, 0, width - divide, height);
      else gl.scissor(0, 0, divide, height);
      const inSpace = viewInSpace(view, view.origin, layer.scene.origin);
      const position = positionOf(inSpace);
      const forward = eye?.forward ?? view.rotation.slice(6, 9);
      const depth = forward.reduce((sum, value, axis) => sum + value * position[axis]!, 0);
      const whole = layer.prepare({ forward, depth });
      const capture = captureOf(layer.scene, layers);
      this.drawLayer(layer, capture, inSpace, options.degree, width, height);
      return whole;
    });
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, eye?.framebuffer ?? null);
    gl.viewport(eye?.x ?? 0, eye?.y ?? 0, width, height);
    gl.useProgram(composite.program);
    gl.uniform2i(composite.uniform("corner"), eye?.x ?? 0, eye?.y ?? 0);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, target.texture);
    if (options.fill > 0) gl.generateMipmap(gl.TEXTURE_2D);
    gl.uniform1i(composite.uniform("picture"), 0);
    gl.uniform4fv(composite.uniform("background"), options.background);
    gl.uniform1f(composite.uniform("fill"), options.fill);
    gl.uniform1i(composite.uniform("divide"), divide);
    gl.uniform2i(
      composite.uniform("linear"),
      Number(layers[0]?.scene.linear ?? false),
      Number(layers[1]?.scene.linear ?? false),
    );
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return whole.every((isWhole) => isWhole);
  }

  /** Free the GPU memory. */
  close(): void {
    this.target.delete();
    this.gl.deleteProgram(this.splats.program);
    this.gl.deleteProgram(this.composite.program);
  }

  private drawLayer(
    layer: SplatLayer,
    capture: readonly Viewpoint[],
    view: View,
    degree: number,
    width: number,
    height: number,
  ): void {
    const { gl, splats } = this;
    const { rotation: r, principal = [0, 0] } = view;
    const position = positionOf(view);
    const { cameraPosition, translation } = cameraUniforms(r, view.translation, position);
    gl.useProgram(splats.program);
    gl.uniform1i(splats.uniform("count"), layer.drawnRows);
    gl.uniform1i(splats.uniform("degree"), Math.min(degree, layer.scene.shDegree));
    gl.uniform1i(splats.uniform("compensated"), Number(layer.compensated));
    gl.uniformMatrix3fv(splats.uniform("rotation"), true, r as number[]);
    gl.uniform3fv(splats.uniform("translation"), translation as number[]);
    gl.uniform3fv(splats.uniform("cameraPosition"), cameraPosition as number[]);
    gl.uniform2f(splats.uniform("focal"), view.focal[0], view.focal[1]);
    gl.uniform2f(splats.uniform("principal"), principal[0], principal[1]);
    gl.uniform2f(splats.uniform("viewport"), width, height);
    gl.uniform1f(splats.uniform("kernel"), layer.scene.kernelPx);
    gl.uniform1i(splats.uniform("antialiased"), Number(layer.scene.antialiased));
    const [x, y, z, area, rest] = trainingPixel(capture, position);
    gl.uniform4f(splats.uniform("trainingPixel"), x, y, z, area);
    gl.uniform1f(splats.uniform("trainingRest"), rest);
    gl.uniform2f(splats.uniform("rgbRange"), layer.ranges.rgbMin, layer.ranges.rgbMax);
    gl.uniform1f(splats.uniform("shRange"), layer.ranges.shRange);
    const { hasLevels, shDegree } = layer.scene;
    gl.uniform1i(splats.uniform("levelled"), Number(hasLevels));
    gl.uniform1f(splats.uniform("between"), layer.between);
    gl.uniform1i(splats.uniform("levels"), hasLevels ? 4 + shDegree : 0);
    const units = 4 + shDegree;
    ["splats", "shapes", "order", "shifts", "sh1", "sh2", "sh3"].forEach((name, unit) => {
      gl.uniform1i(splats.uniform(name), unit < units ? unit : 0);
    });
    const instances = Math.ceil(layer.drawnRows / SPLATS_PER_INSTANCE);
    gl.drawArraysInstanced(gl.TRIANGLES, 0, 3 * SPLATS_PER_INSTANCE, instances);
  }

  private build(): [Program, Program, Target] {
    const { gl } = this;
    const programs = [
      new Program(gl, VERTEX_SHADER, FRAGMENT_SHADER, "count"),
      new Program(gl, WHOLE_PICTURE_SHADER, COMPOSITE_SHADER, "fill"),
    ] as const;
    gl.bindVertexArray(gl.createVertexArray());
    return [...programs, new Target(gl)];
  }
}

/** Error of a browser or a machine without WebGL 2. */
export class NoWebGlError extends Error {
  override readonly name = "NoWebGlError";
}

/** Return the viewpoints of a scene, else those of the version of it that is drawn beside it. */
function captureOf(scene: LayerScene, layers: readonly SplatLayer[]): readonly Viewpoint[] {
  const known = [scene, ...layers.map((layer) => layer.scene)].find(({ capture }) => capture.length > 0);
  if (known === undefined || known === scene) return scene.capture;
  return movedCapture(
    known.capture,
    known.origin.map((value, axis) => value - scene.origin[axis]!),
  );
}

/** Return the position of the camera, in the space of the means. */
function positionOf({ rotation: r, translation: t }: View): number[] {
  return [0, 1, 2].map((i) => -(r[i]! * t[0]! + r[3 + i]! * t[1]! + r[6 + i]! * t[2]!));
}

/** Return a view in the space of another scene's means. */
function viewInSpace(view: View, from: readonly number[], to: readonly number[]): View {
  if (from === to) return view;
  const { rotation: r } = view;
  const shift = to.map((value, i) => value - from[i]!);
  const translation = view.translation.map(
    (value, row) => value + [0, 1, 2].reduce((sum, i) => sum + r[3 * row + i]! * shift[i]!, 0),
  );
  return { ...view, translation };
}

/** A program and the locations of its uniforms. */
class Program {
  readonly program: WebGLProgram;
  private isLinked = false;
  private readonly locations = new Map<string, WebGLUniformLocation | null>();

  /** @param known - Name of one of its uniforms. */
  constructor(
    private readonly gl: WebGL2RenderingContext,
    vertex: string,
    fragment: string,
    private readonly known: string,
  ) {
    this.program = gl.createProgram();
    for (const [type, source] of [
      [gl.VERTEX_SHADER, vertex],
      [gl.FRAGMENT_SHADER, fragment],
    ] as const) {
      const shader = gl.createShader(type);
      if (shader === null) throw new NoWebGlError("the graphics were lost");
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
  }

  get isReady(): boolean {
    const { gl, program } = this;
    if (this.isLinked) return true;
    // Querying the status would block the page until the program is built.
    const parallel = gl.getExtension("KHR_parallel_shader_compile");
    if (parallel !== null && gl.getProgramParameter(program, parallel.COMPLETION_STATUS_KHR) === false) return false;
    if (gl.getProgramParameter(program, gl.LINK_STATUS) === false && !gl.isContextLost()) {
      throw new NoWebGlError(gl.getProgramInfoLog(program) ?? "no program");
    }
    this.isLinked = true;
    // The first query of a uniform blocks until the GPU is idle, as it is now.
    this.uniform(this.known);
    return true;
  }

  uniform(name: string): WebGLUniformLocation | null {
    let location = this.locations.get(name);
    if (location === undefined) {
      location = this.gl.getUniformLocation(this.program, name);
      this.locations.set(name, location);
    }
    return location;
  }
}

/**
 * Render target of the blended splats: half floats, because colours may exceed 1, and hundreds of splats in a pixel add
 * up rounding errors of 8 bits. Without half float targets it has 8 bits.
 */
class Target {
  readonly framebuffer: WebGLFramebuffer;
  texture: WebGLTexture | null = null;
  private width = 0;
  private height = 0;
  private readonly format: number;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.framebuffer = gl.createFramebuffer();
    const halfFloats = gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float");
    this.format = halfFloats === null ? gl.RGBA8 : gl.RGBA16F;
  }

  resize(width: number, height: number): void {
    const { gl } = this;
    if (width === this.width && height === this.height) return;
    [this.width, this.height] = [width, height];
    gl.deleteTexture(this.texture);
    this.texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1 + Math.floor(Math.log2(Math.max(width, height))), this.format, width, height);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
  }

  delete(): void {
    this.gl.deleteTexture(this.texture);
    this.gl.deleteFramebuffer(this.framebuffer);
  }
}
