import type { Shifts } from "../container/compensation.js";
import type { Viewpoint } from "../container/root.js";
import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";
import type { ViewPlane } from "./depth_order.js";
import type { DepthSorter } from "./depth_sorter.js";
import { RowOrder } from "./row_order.js";
import { readMeans, type ShaderRows } from "./shader_rows.js";
import { TEXTURE_WIDTH } from "./shaders.js";
import { SplatTextures } from "./splat_textures.js";

/** Properties of a scene that drawing needs. */
export interface LayerScene {
  /** Splats of the scene. */
  readonly splats: number;
  readonly shDegree: number;
  /** World position of the means' zero, scene units. */
  readonly origin: readonly number[];
  readonly linear: boolean;
  /** Variance added to projected covariances, pixels². */
  readonly kernelPx: number;
  readonly antialiased: boolean;
  /** Viewpoints of the training pictures; may be empty. */
  readonly capture: readonly Viewpoint[];
  /** Whether opacities differ between levels (SPEC 5.11). */
  readonly hasLevels: boolean;
}

/** One scene drawn: its rows, and their order for the view. */
export class SplatLayer {
  private allocated: number;
  private readonly textures: SplatTextures;
  /** Rows received, from the first on. */
  private arrived = 0;
  /** Whether any row has compensation. */
  compensated = false;
  /** Weight of the finer one of the two levels whose opacities are mixed. */
  between = 0;
  /** Duration of the last sort, ms. */
  sortMilliseconds = 0;
  private most = Infinity;
  /** Rows whose memory is kept. */
  private kept = Infinity;
  /** Ends of the chunks written, rows. */
  private readonly ends = new Set<number>();
  private readonly order: RowOrder;
  /** Rows of the last picture. */
  drawnRows = 0;

  /**
   * @param ranges - Value ranges of the codes of packed rows.
   * @param capacity - Rows held at most.
   * @param makeSorter - Makes the sorter for a number of rows.
   * @param changed - Called when a new picture is needed.
   */
  constructor(
    private readonly gl: WebGL2RenderingContext,
    readonly scene: LayerScene,
    readonly ranges: PackRanges,
    capacity: number,
    makeSorter: (rows: number) => DepthSorter,
    private readonly changed: () => void,
  ) {
    const lines = gl.getParameter(gl.MAX_TEXTURE_SIZE) as number;
    this.allocated = Math.min(scene.splats, capacity, lines * TEXTURE_WIDTH);
    this.textures = new SplatTextures(this.capacity, scene.shDegree, scene.hasLevels);
    this.textures.allocate(gl);
    // The textures take over orders, whose memory is uploaded in whole lines.
    const sorter = makeSorter(TEXTURE_WIDTH * Math.ceil(this.capacity / TEXTURE_WIDTH));
    this.order = new RowOrder(sorter, ({ order, rows, milliseconds }) => {
      const spare = this.textures.writeOrder(order, rows);
      this.drawnRows = rows;
      this.shrink();
      this.sortMilliseconds = milliseconds;
      this.changed();
      return spare;
    });
  }

  /** Rows of allocated memory. */
  get capacity(): number {
    return this.allocated;
  }

  /** Rows drawn once they are sorted. */
  get rows(): number {
    return Math.min(this.arrived, this.most, this.kept);
  }

  /** Words of all rows. */
  get shaderRows(): ShaderRows {
    return this.textures.shaderRows;
  }

  /** Whether a sort is running. */
  get isSorting(): boolean {
    return this.order.isSorting;
  }

  /** Write a chunk's rows. */
  write(packed: PackedSplats, firstRow: number): void {
    if (firstRow + packed.count > this.capacity) return;
    this.textures.write(packed, firstRow);
    this.ends.add(firstRow + packed.count);
    this.arrived = Math.max(this.arrived, firstRow + packed.count);
    this.order.add(firstRow, packed.means);
    // The sort need not wait for a picture, unless there was no view yet.
    this.order.show(this.rows);
    if (!this.order.isSorting) this.changed();
  }

  /** Hide rows. */
  clear(firstRow: number, count: number): void {
    this.textures.clear(firstRow, count);
    this.changed();
  }

  /** Replace rows without changing their means, and so their order. */
  repaint(packed: PackedSplats, firstRow: number): void {
    if (firstRow + packed.count > this.capacity) return;
    this.textures.write(packed, firstRow);
    this.changed();
  }

  /** Write the opacities of rows at two adjacent levels, from `LevelOpacities`. */
  writeLevels(words: Uint32Array, firstRow: number): void {
    if (firstRow + words.length > this.capacity) return;
    this.textures.writeLevels(words, firstRow);
  }

  /** Read the means of rows that were written, three numbers each. */
  readMeans(firstRow: number, means: Float32Array): void {
    if (firstRow + means.length / 3 <= this.capacity) readMeans(this.shaderRows, firstRow, means);
  }

  /** Write the compensation of rows. */
  shift(firstRow: number, count: number, shifts: Shifts | undefined): void {
    if (firstRow + count > this.capacity) return;
    this.textures.writeShifts(firstRow, count, shifts);
    this.changed();
  }

  /** Draw only the first rows. */
  limit(rows: number): void {
    this.most = Math.max(rows, 1);
    this.order.show(this.rows);
    this.changed();
  }

  /** Draw only the chunks within the first rows, and free the memory of all others once they are not drawn. */
  release(rows: number): void {
    const whole = Math.max(...[...this.ends].filter((end) => end <= rows), 0);
    // Of a chunk that is only partly there, later changes could not be written.
    this.kept = this.arrived > rows && whole > 0 ? whole : Math.max(rows, 1);
    this.order.show(this.rows);
    this.changed();
  }

  /** Make the textures again after the WebGL context was lost. */
  restore(): void {
    this.textures.allocate(this.gl);
    this.changed();
  }

  /** Upload a part of the changes; return whether none are left. */
  upload(): boolean {
    return this.textures.upload(this.gl);
  }

  /**
   * Bind the textures, and start a sort if the view requires one.
   *
   * @param plane - Plane of the camera, in the space of the means.
   * @returns Whether all rows received are bound in the order of the view.
   */
  prepare(plane: ViewPlane): boolean {
    const isCurrent = this.order.look(plane);
    this.textures.bind(this.gl);
    return isCurrent;
  }

  close(): void {
    this.order.close();
    this.textures.delete(this.gl);
  }

  /** Free the memory of released rows, once the drawing order is without them. */
  private shrink(): void {
    if (this.kept >= this.allocated || this.drawnRows > this.kept) return;
    this.allocated = this.kept;
    this.arrived = Math.min(this.arrived, this.kept);
    this.textures.shrink(this.gl, this.kept);
  }
}
