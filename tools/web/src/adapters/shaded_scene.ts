import type { Shifts } from "../container/compensation.js";
import type { ChunkUpdate } from "../loader/stream_options.js";
import type { StreamedScene } from "../loader/streamed_scene.js";
import { DEFAULT_RANGES, SH_WORDS, shiftPacked } from "../scene/packed_splats.js";
import { trainingPixel } from "../scene/training_pixel.js";
import type { ViewPlane } from "../viewer/depth_order.js";
import { cameraUniforms, type ShaderRows, writeShaderRows } from "../viewer/shader_rows.js";
import { TEXTURE_WIDTH } from "../viewer/shaders.js";
import { type AdapterOptions, streamRows, wantedDegree } from "./row_stream.js";
import { SortedRows } from "./sorted_rows.js";

/** Options of a stream into an engine that draws with the viewer's shaders. */
export interface ShadedOptions extends AdapterOptions {
  /** Called when a new picture is needed, for pages that do not draw all the time. */
  readonly onChange?: () => void;
}

/** A texture of the shaders, `TEXTURE_WIDTH` texels wide. */
export interface ShaderTexture {
  /** Name of its sampler. */
  readonly name: string;
  readonly data: Uint32Array<ArrayBuffer>;
  /** Words of a texel. */
  readonly words: 1 | 2 | 4;
}

/** Samplers of the shaders; those without a texture are declared and not read. */
export const SAMPLERS = ["splats", "shapes", "order", "sh1", "sh2", "sh3", "shifts", "levels"] as const;

/** Uniforms of the shaders by name. */
export type Uniforms = Readonly<Record<string, number | boolean | ArrayLike<number>>>;

/** Matrices of a picture, column by column, as OpenGL takes them. */
export interface PictureMatrices {
  /** World to camera. */
  readonly view: ArrayLike<number>;
  readonly projection: ArrayLike<number>;
}

/** Rows of a scene, their order by depth and the uniforms of `viewer/shaders.ts`, for an engine that draws with these. */
export class ShadedScene {
  /** Textures, which change in place. */
  readonly textures: readonly ShaderTexture[];
  /** Lines of every texture. */
  readonly lines: number;
  /** Uniforms that stay. */
  readonly constants: Uniforms;
  /** Number of rows in the order. */
  count = 0;
  private readonly rows: ShaderRows;
  private readonly bands: readonly Uint32Array<ArrayBuffer>[];
  private readonly sorting: SortedRows;

  /** @param changed - Called with the names of the textures that have changed. */
  constructor(
    private readonly scene: StreamedScene,
    private readonly options: ShadedOptions,
    private readonly changed: (names: readonly string[]) => void,
  ) {
    const { info } = scene;
    const degree = wantedDegree(scene, options);
    this.lines = Math.max(1, Math.ceil(info.splats / TEXTURE_WIDTH));
    const capacity = this.lines * TEXTURE_WIDTH;
    const [splats, shapes] = [new Uint32Array(4 * capacity), new Uint32Array(2 * capacity)];
    this.rows = { splats, shapes };
    this.bands = SH_WORDS.slice(0, degree).map((words) => new Uint32Array(words * capacity));
    const order = new Uint32Array(capacity);
    this.textures = [
      { name: "splats", data: splats, words: 4 },
      { name: "shapes", data: shapes, words: 2 },
      { name: "order", data: order, words: 1 },
      ...this.bands.map((data, i) => ({ name: `sh${i + 1}`, data, words: SH_WORDS[i]! })),
    ];
    const { rgbMin, rgbMax, shRange } = DEFAULT_RANGES;
    this.constants = {
      ...{ degree, kernel: info.kernelPx, antialiased: info.antialiased, rgbRange: [rgbMin, rgbMax], shRange },
      ...{ compensated: false, levelled: false, between: 0 },
    };
    const floats = new Float32Array(splats.buffer);
    const means = () => Float32Array.from({ length: 3 * capacity }, (_, i) => floats[4 * Math.floor(i / 3) + (i % 3)]!);
    this.sorting = new SortedRows(means, capacity, (sorted, count) => {
      order.set(sorted.subarray(0, count));
      this.count = count;
      this.show(["order"]);
    });
  }

  /** Fill the textures as chunks arrive; resolves when all have. */
  async stream(signal: AbortSignal): Promise<void> {
    const names = this.textures.map(({ name }) => name).filter((name) => name !== "order");
    return streamRows(
      this.scene,
      {
        format: "packed",
        write: (update, shifts) => {
          this.write(update, shifts);
          this.sorting.add(update.firstRow, update.packed!.means);
        },
        upload: (count) => {
          this.show(names);
          this.sorting.show(count);
        },
      },
      this.options,
      signal,
    );
  }

  /**
   * Return the uniforms of a picture, and sort for its direction of view.
   *
   * @param world - Matrix from the space of the means to the world, column by column; it may scale and reflect.
   * @param size - Width and height of the picture, px.
   */
  draw(matrices: PictureMatrices, world: ArrayLike<number>, size: readonly [number, number]): Uniforms {
    const { plane, uniforms } = uniformsOf(matrices, world, size);
    this.sorting.look(plane);
    const pixel = trainingPixel(this.scene.info.capture, uniforms.cameraPosition as readonly number[]);
    return { ...uniforms, trainingPixel: pixel.slice(0, 4), trainingRest: pixel[4], count: this.count };
  }

  close(): void {
    this.sorting.close();
  }

  /** Write a chunk's rows, with their shifts of compensation (SPEC 8.5). */
  private write({ firstRow, packed }: ChunkUpdate, shifts: Shifts | undefined): void {
    const words = shifts === undefined ? packed!.words : new Uint32Array(packed!.words.length);
    if (shifts !== undefined) shiftPacked(packed!.words, shifts, words, 0);
    writeShaderRows({ ...packed!, words }, this.rows, firstRow);
    packed!.sh.slice(0, this.bands.length).forEach((band, i) => {
      this.bands[i]!.set(band, SH_WORDS[i]! * firstRow);
    });
  }

  private show(names: readonly string[]): void {
    this.changed(names);
    this.options.onChange?.();
  }
}

/** Return the uniforms of a picture, and the plane of its camera in the space of the means. */
export function uniformsOf(
  { view: v, projection: p }: PictureMatrices,
  world: ArrayLike<number>,
  [width, height]: readonly [number, number],
): { readonly plane: ViewPlane; readonly uniforms: Uniforms } {
  // The view looks along −z in right-handed worlds and along z in left-handed ones.
  const front = Math.sign(p[11]!);
  const row = (i: number, sign: number): number[] =>
    [0, 1, 2, 3].map((j) => sign * [0, 1, 2, 3].reduce((sum, k) => sum + v[4 * k + i]! * world[4 * j + k]!, 0));
  // x right, y down, z forward.
  const [x, y, z] = [row(0, 1), row(1, -1), row(2, front)] as [number[], number[], number[]];
  const size = Math.hypot(z[0]!, z[1]!, z[2]!);
  const forward = z.slice(0, 3).map((value) => value / size);
  const position = solve(x, y, z);
  const rows = [x, y, z].flatMap((values) => values.slice(0, 3));
  return {
    plane: { forward, depth: forward.reduce((sum, value, axis) => sum + value * position[axis]!, 0) },
    uniforms: {
      rotation: [0, 1, 2].flatMap((j) => [x[j]!, y[j]!, z[j]!]),
      ...cameraUniforms(rows, [x[3]!, y[3]!, z[3]!], position),
      focal: [(p[0]! * width) / 2, (p[5]! * height) / 2],
      viewport: [width, height],
      middle: [front * p[8]!, front * p[9]!],
      depth: [front * p[10]!, p[14]!],
    },
  };
}

/** Return the point that an affine map of three rows of four numbers takes to the origin. */
function solve(x: readonly number[], y: readonly number[], z: readonly number[]): number[] {
  const cross = (a: readonly number[], b: readonly number[]): number[] => [
    a[1]! * b[2]! - a[2]! * b[1]!,
    a[2]! * b[0]! - a[0]! * b[2]!,
    a[0]! * b[1]! - a[1]! * b[0]!,
  ];
  const [yz, zx, xy] = [cross(y, z), cross(z, x), cross(x, y)];
  const determinant = x[0]! * yz[0]! + x[1]! * yz[1]! + x[2]! * yz[2]!;
  return [0, 1, 2].map((i) => -(x[3]! * yz[i]! + y[3]! * zx[i]! + z[3]! * xy[i]!) / determinant);
}
