import { SH_WORDS, type PackedSplats } from "../scene/packed_splats.js";
import { TEXTURE_WIDTH } from "./shaders.js";

/** A texture of unsigned integers, one texel a splat, with a copy in memory from which changed rows are uploaded. */
class RowTexture {
  readonly words: Uint32Array;
  private readonly texture: WebGLTexture;
  private first = Infinity;
  private end = 0;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly channels: 1 | 2 | 4,
    rows: number,
  ) {
    const height = Math.max(1, Math.ceil(rows / TEXTURE_WIDTH));
    this.words = new Uint32Array(TEXTURE_WIDTH * height * channels);
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    const format = { 1: gl.R32UI, 2: gl.RG32UI, 4: gl.RGBA32UI }[channels];
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, TEXTURE_WIDTH, height);
  }

  /** Note that rows have changed. */
  touch(first: number, count: number): void {
    this.first = Math.min(this.first, first);
    this.end = Math.max(this.end, first + count);
  }

  /** Bind to a unit, after uploading the lines that have changed. */
  bind(unit: number): void {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    if (this.end === 0) return;
    const line = Math.floor(this.first / TEXTURE_WIDTH);
    const lines = Math.ceil(this.end / TEXTURE_WIDTH) - line;
    const format = { 1: gl.RED_INTEGER, 2: gl.RG_INTEGER, 4: gl.RGBA_INTEGER }[this.channels];
    const part = this.words.subarray(line * TEXTURE_WIDTH * this.channels, (line + lines) * TEXTURE_WIDTH * this.channels);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, line, TEXTURE_WIDTH, lines, format, gl.UNSIGNED_INT, part);
    [this.first, this.end] = [Infinity, 0];
  }

  delete(): void {
    this.gl.deleteTexture(this.texture);
  }
}

/** The textures of a scene: splats, SH bands and the order in which they are drawn. */
export class SplatTextures {
  readonly splats: RowTexture;
  readonly order: RowTexture;
  readonly bands: RowTexture[];

  constructor(gl: WebGL2RenderingContext, rows: number, degree: number) {
    this.splats = new RowTexture(gl, 4, rows);
    this.order = new RowTexture(gl, 1, rows);
    this.bands = SH_WORDS.slice(0, degree).map((words) => new RowTexture(gl, words, rows));
  }

  /** Put a chunk's rows where they belong. */
  write(packed: PackedSplats, firstRow: number): void {
    this.splats.words.set(packed.words, 4 * firstRow);
    this.splats.touch(firstRow, packed.count);
    packed.sh.forEach((band, i) => {
      this.bands[i]!.words.set(band, SH_WORDS[i]! * firstRow);
      this.bands[i]!.touch(firstRow, packed.count);
    });
  }

  delete(): void {
    for (const texture of [this.splats, this.order, ...this.bands]) texture.delete();
  }
}
