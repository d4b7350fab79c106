import type { Shifts } from "../container/compensation.js";
import { type PackedSplats, SH_WORDS } from "../scene/packed_splats.js";
import { type ShaderRows, writeShaderRows } from "./shader_rows.js";
import { OPACITY_STEPS, SCALE_STEPS, TEXTURE_WIDTH } from "./shaders.js";

/**
 * Bytes of textures uploaded at once. Chromium passes WebGL uploads through a buffer of 16 MiB; filling it blocks until
 * the GPU has read from it.
 */
const BYTES_AT_ONCE = 4 << 20;
/** Adjacent lines uploaded by one call, at most: each call has a cost, and large ones wait for a free part of the buffer. */
const LINES_AT_ONCE = 32;

/** A texture of unsigned integers, one texel per splat, with a copy in memory from which changed lines are uploaded. */
class RowTexture {
  words: Uint32Array;
  private texture: WebGLTexture | undefined;
  private height: number;
  /** Lines that differ from the texture. */
  private readonly changed = new Set<number>();

  constructor(
    private readonly channels: 1 | 2 | 4,
    rows: number,
  ) {
    this.height = Math.max(1, Math.ceil(rows / TEXTURE_WIDTH));
    this.words = new Uint32Array(TEXTURE_WIDTH * this.height * channels);
  }

  /** Make the texture, also after the WebGL context was lost. */
  allocate(gl: WebGL2RenderingContext): void {
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    const format = { 1: gl.R32UI, 2: gl.RG32UI, 4: gl.RGBA32UI }[this.channels];
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, TEXTURE_WIDTH, this.height);
  }

  /** Mark rows as changed. */
  touch(first: number, count: number): void {
    const end = Math.min(Math.ceil((first + count) / TEXTURE_WIDTH), this.height);
    for (let line = Math.floor(first / TEXTURE_WIDTH); line < end; line++) this.changed.add(line);
  }

  /** Free the memory of all but the first rows; `frame` is a framebuffer for the copy of what stays. */
  shrink(gl: WebGL2RenderingContext, rows: number, frame: WebGLFramebuffer): void {
    const before = this.texture!;
    this.height = Math.max(1, Math.ceil(rows / TEXTURE_WIDTH));
    this.words = this.words.slice(0, TEXTURE_WIDTH * this.height * this.channels);
    for (const line of this.changed) if (line >= this.height) this.changed.delete(line);
    gl.activeTexture(gl.TEXTURE0);
    this.allocate(gl);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.READ_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, before, 0);
    gl.copyTexSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 0, 0, TEXTURE_WIDTH, this.height);
    gl.deleteTexture(before);
  }

  /** Upload about `mostBytes` of changed lines; return the number of bytes. */
  upload(gl: WebGL2RenderingContext, mostBytes: number): number {
    if (this.changed.size === 0) return 0;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture!);
    const format = { 1: gl.RED_INTEGER, 2: gl.RG_INTEGER, 4: gl.RGBA_INTEGER }[this.channels];
    const size = TEXTURE_WIDTH * this.channels;
    let bytes = 0;
    for (const line of this.changed) {
      if (bytes >= mostBytes) break;
      let end = line;
      for (; end - line < LINES_AT_ONCE && this.changed.delete(end); end++) bytes += 4 * size;
      const part = this.words.subarray(line * size, end * size);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, line, TEXTURE_WIDTH, end - line, format, gl.UNSIGNED_INT, part);
    }
    return bytes;
  }

  /** Whether the texture is up to date. */
  get isUploaded(): boolean {
    return this.changed.size === 0;
  }

  bind(gl: WebGL2RenderingContext, unit: number): void {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, this.texture!);
  }

  delete(gl: WebGL2RenderingContext): void {
    gl.deleteTexture(this.texture ?? null);
  }
}

/**
 * Textures of a scene: splats, shapes, compensation, SH bands, drawing order and, for scenes with levels, opacities at two
 * adjacent levels.
 */
export class SplatTextures {
  private readonly splats: RowTexture;
  private readonly shapes: RowTexture;
  private readonly shifts: RowTexture;
  private readonly order: RowTexture;
  private readonly bands: RowTexture[];
  private readonly levels: RowTexture | undefined;

  /** Number of rows written, from the first on. */
  private written = 0;

  constructor(rows: number, degree: number, hasLevels: boolean) {
    this.splats = new RowTexture(4, rows);
    this.shapes = new RowTexture(2, rows);
    this.shifts = new RowTexture(1, rows);
    this.order = new RowTexture(1, rows);
    this.bands = SH_WORDS.slice(0, degree).map((words) => new RowTexture(words, rows));
    this.levels = hasLevels ? new RowTexture(1, rows) : undefined;
  }

  /** Words of the rows. */
  get shaderRows(): ShaderRows {
    return { splats: this.splats.words, shapes: this.shapes.words };
  }

  private get all(): readonly RowTexture[] {
    return [this.splats, this.shapes, this.order, this.shifts, ...this.bands, ...(this.levels ? [this.levels] : [])];
  }

  /** Make the textures, also after the WebGL context was lost; written rows are uploaded again. */
  allocate(gl: WebGL2RenderingContext): void {
    for (const texture of this.all) {
      texture.allocate(gl);
      // WebGL fills textures with zeros, which need no upload.
      texture.touch(0, this.written);
    }
  }

  /** Free the memory of all but the first rows. */
  shrink(gl: WebGL2RenderingContext, rows: number): void {
    this.written = Math.min(this.written, rows);
    const frame = gl.createFramebuffer();
    for (const texture of this.all) texture.shrink(gl, rows, frame);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
  }

  /** Write a chunk's rows. */
  write(packed: PackedSplats, firstRow: number): void {
    this.written = Math.max(this.written, firstRow + packed.count);
    writeShaderRows(packed, this.shaderRows, firstRow);
    this.splats.touch(firstRow, packed.count);
    this.shapes.touch(firstRow, packed.count);
    packed.sh.slice(0, this.bands.length).forEach((band, i) => {
      this.bands[i]!.words.set(band, SH_WORDS[i]! * firstRow);
      this.bands[i]!.touch(firstRow, packed.count);
    });
  }

  /** Make rows transparent; transparent splats are not drawn. */
  clear(firstRow: number, count: number): void {
    this.splats.words.fill(0, 4 * firstRow, 4 * (firstRow + count));
    this.splats.touch(firstRow, count);
  }

  /** Write the opacities of rows at two adjacent levels, from `LevelOpacities`. */
  writeLevels(words: Uint32Array, firstRow: number): void {
    this.levels!.words.set(words, firstRow);
    this.levels!.touch(firstRow, words.length);
  }

  /** Write the compensation of rows. */
  writeShifts(firstRow: number, count: number, shifts: Shifts | undefined): void {
    const words = this.shifts.words.subarray(firstRow, firstRow + count);
    if (shifts === undefined) words.fill(0);
    else for (let i = 0; i < count; i++) words[i] = shiftWord(shifts.scales[i]!, shifts.opacities[i]!);
    this.shifts.touch(firstRow, count);
  }

  /**
   * Set the drawing order of the first rows.
   *
   * @param order - Rows in their order, as many as there is memory for, in whole lines; the textures keep the array.
   * @returns An unused array in its place.
   */
  writeOrder(order: Uint32Array, rows: number): Uint32Array {
    const spare = this.order.words;
    this.order.words = order;
    this.order.touch(0, rows);
    return spare;
  }

  /** Upload at most `BYTES_AT_ONCE` changed bytes and the order; return whether nothing is left to upload. */
  upload(gl: WebGL2RenderingContext): boolean {
    let left = BYTES_AT_ONCE;
    // An order is uploaded as a whole.
    for (const texture of this.all) left -= texture.upload(gl, texture === this.order ? Infinity : left);
    return this.all.every((texture) => texture.isUploaded);
  }

  /** Bind all textures to units: splats, shapes, order, shifts, then the bands and the opacities of levels. */
  bind(gl: WebGL2RenderingContext): void {
    this.all.forEach((texture, unit) => {
      texture.bind(gl, unit);
    });
  }

  delete(gl: WebGL2RenderingContext): void {
    for (const texture of this.all) texture.delete(gl);
  }
}

/** Return two numbers in steps of 16 bits each. */
function shiftWord(scale: number, opacity: number): number {
  return (Math.round(scale * SCALE_STEPS) & 0xffff) | (Math.round(opacity * OPACITY_STEPS) << 16);
}
