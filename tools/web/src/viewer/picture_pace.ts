/** A picture that takes longer is one of slow graphics, ms. */
const SLOW_PICTURE = 45;
/** Least share of the pixels of each side that is drawn in haste. */
const LEAST_SCALE = 0.4;
/** By how much that share grows from one picture to the next, at most. */
const MOST_GROWTH = 1.5;
/** Shares are rounded to this step, because every change makes textures anew. */
const SCALE_STEP = 0.05;

/** Commands that were given; those of a picture have its size, as a share of the pixels of each side. */
interface UnderWay {
  readonly sync: WebGLSync;
  readonly begun: number;
  readonly scale: number | undefined;
}

/**
 * Follows the pictures that the graphics work on, so that no more are begun than they can finish: those that wait would
 * show what is no longer asked for, and full queues hold up the page.
 */
export class PicturePace {
  /** Duration of the last picture, from its first command until the graphics had finished it, ms. */
  milliseconds = 0;
  /** Pixels of each side that pictures in haste have, as a share of all; few until it is known how long a picture takes. */
  scale = LEAST_SCALE;
  private readonly underWay: UnderWay[] = [];

  constructor(private readonly gl: WebGL2RenderingContext) {}

  /** Whether the graphics take so long that work between pictures matters. */
  get isSlow(): boolean {
    return this.milliseconds > SLOW_PICTURE || this.milliseconds === 0;
  }

  /** Whether nothing is left to finish. */
  get isIdle(): boolean {
    this.look();
    return this.underWay.length === 0;
  }

  /** Whether another picture may be begun: quick graphics work on one while the next is prepared. */
  get isFree(): boolean {
    this.look();
    return this.underWay.length < (this.isSlow ? 1 : 2);
  }

  /**
   * Note that the commands of a picture were given.
   *
   * @param begun - When the first of them was, by `performance.now`.
   * @param scale - Pixels of each side, as a share of all.
   */
  given(begun: number, scale: number): void {
    this.follow(begun, scale);
  }

  /** Note that textures are uploaded, which is no picture but takes its time too. */
  uploads(): void {
    this.follow(performance.now(), undefined);
  }

  private follow(begun: number, scale: number | undefined): void {
    const { gl } = this;
    const sync = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    if (sync !== null) this.underWay.push({ sync, begun, scale });
  }

  /** Forget pictures of graphics that were lost. */
  forget(): void {
    this.underWay.length = 0;
  }

  private look(): void {
    const { gl, underWay } = this;
    while (underWay.length > 0 && gl.clientWaitSync(underWay[0]!.sync, 0, 0) !== gl.TIMEOUT_EXPIRED) {
      const { sync, begun, scale } = underWay.shift()!;
      gl.deleteSync(sync);
      if (scale === undefined) continue;
      this.milliseconds = performance.now() - begun;
      // Most of the work of slow graphics is for pixels.
      const wanted = scale * Math.sqrt(SLOW_PICTURE / Math.max(this.milliseconds, 1));
      // The next one may show more splats than this one did.
      const next = Math.min(wanted, this.scale * MOST_GROWTH, 1);
      this.scale = Math.max(Math.round(next / SCALE_STEP) * SCALE_STEP, LEAST_SCALE);
    }
  }
}
