import type { Shifts } from "../container/compensation.js";
import type { Viewpoint } from "../container/root.js";
import type { PackedSplats, PackRanges } from "../scene/packed_splats.js";
import type { ViewPlane } from "./depth_order.js";
import type { DepthSorter } from "./depth_sorter.js";
import type { ShaderRows } from "./shader_rows.js";
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

/** Cosine of the angle by which a view may turn before rows are sorted again: 0.05 degrees. */
const SAME_DIRECTION = 1 - 4e-7;

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
  private sorted: { readonly rows: number; readonly forward: readonly number[] } | undefined;
  private sorting = false;
  private stale = true;
  private spare: Uint32Array | undefined;
  /** Plane of the last view. */
  private plane: ViewPlane | undefined;
  private closed = false;

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
    this.sorter = makeSorter(TEXTURE_WIDTH * Math.ceil(this.capacity / TEXTURE_WIDTH));
  }

  private readonly sorter: DepthSorter;

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

  /** Rows of the last picture. */
  get drawnRows(): number {
    return this.sorted?.rows ?? 0;
  }

  /** Whether a sort is running that includes more rows than the last one. */
  get isSorting(): boolean {
    return this.sorting;
  }

  /** Write a chunk's rows. */
  write(packed: PackedSplats, firstRow: number): void {
    if (firstRow + packed.count > this.capacity) return;
    this.textures.write(packed, firstRow);
    this.ends.add(firstRow + packed.count);
    this.arrived = Math.max(this.arrived, firstRow + packed.count);
    this.sorter.add(firstRow, packed.means);
    this.stale = true;
    // New rows are drawn once sorted, and the sort need not wait for a picture.
    if (this.plane === undefined) this.changed();
    else void this.sort(this.plane);
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

  /** Write the compensation of rows. */
  shift(firstRow: number, count: number, shifts: Shifts | undefined): void {
    if (firstRow + count > this.capacity) return;
    this.textures.writeShifts(firstRow, count, shifts);
    this.changed();
  }

  /** Draw only the first rows. */
  limit(rows: number): void {
    this.most = Math.max(rows, 1);
    this.stale = true;
    this.changed();
  }

  /** Draw only the chunks within the first rows, and free the memory of all others once they are not drawn. */
  release(rows: number): void {
    const whole = Math.max(...[...this.ends].filter((end) => end <= rows), 0);
    // Of a chunk that is only partly there, later changes could not be written.
    this.kept = this.arrived > rows && whole > 0 ? whole : Math.max(rows, 1);
    this.stale = true;
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
    this.plane = plane;
    const before = this.sorted?.forward;
    const turned =
      before === undefined || before.reduce((sum, value, i) => sum + value * plane.forward[i]!, 0) < SAME_DIRECTION;
    if ((this.stale || turned) && this.rows > 0) void this.sort(plane);
    this.textures.bind(this.gl);
    return !this.sorting && (this.rows === 0 || !(this.stale || turned));
  }

  close(): void {
    this.closed = true;
    this.sorter.close();
    this.textures.delete(this.gl);
  }

  /** Free the memory of released rows, once the drawing order is without them. */
  private shrink(): void {
    if (this.kept >= this.allocated || this.drawnRows > this.kept) return;
    this.allocated = this.kept;
    this.arrived = Math.min(this.arrived, this.kept);
    this.textures.shrink(this.gl, this.kept);
  }

  private async sort(plane: ViewPlane): Promise<void> {
    if (this.sorting) return;
    this.sorting = true;
    this.stale = false;
    const { order, rows, milliseconds } = await this.sorter.sort(this.rows, plane, this.spare);
    this.sorting = false;
    if (this.closed) return;
    this.spare = this.textures.writeOrder(order, rows);
    this.sorted = { rows, forward: plane.forward };
    this.shrink();
    this.sortMilliseconds = milliseconds;
    this.changed();
    // Rows that arrived meanwhile need not wait for a picture either.
    if (this.stale) void this.sort(this.plane!);
  }
}
