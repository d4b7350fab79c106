/** A picture that takes longer is one of slow graphics, ms. */
const SLOW_PICTURE = 45;
/** Least share of the pixels of each side that is drawn in haste. */
const LEAST_SCALE = 0.4;
/** By how much that share grows from one picture to the next, at most. */
const MOST_GROWTH = 1.5;
/** More splats take longer, in proportion where they are many; at most so many times, because every picture takes some time. */
const MOST_LONGER = 10;
/** What the first picture is expected to take, ms. */
const FIRST_PICTURE = 100;
/** Shares are rounded to this step, because every change makes textures anew. */
const SCALE_STEP = 0.05;

/** A picture: pixels of each side, as a share of all, and its splats. */
interface Picture {
  readonly scale: number;
  readonly splats: number;
}

/** Commands that were given. */
interface UnderWay {
  readonly sync: WebGLSync;
  readonly begun: number;
  readonly picture: Picture | undefined;
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
  /** Splats of the next picture, as far as they have come. */
  splats = 0;
  /** Splats of the last picture. */
  private drawn = 0;
  private readonly underWay: UnderWay[] = [];

  constructor(private readonly gl: WebGL2RenderingContext) {}

  /** How long the next picture takes by what the last one took, ms. */
  get expected(): number {
    if (this.milliseconds === 0) return FIRST_PICTURE;
    return this.milliseconds * Math.min(Math.max(this.splats / Math.max(this.drawn, 1), 1), MOST_LONGER);
  }

  /** Whether the graphics take so long that work between pictures matters. */
  get isSlow(): boolean {
    return this.expected > SLOW_PICTURE;
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
   */
  given(begun: number, picture: Picture): void {
    this.follow(begun, picture);
  }

  /** Note that textures are uploaded, which is no picture but takes its time too. */
  uploads(): void {
    this.follow(performance.now(), undefined);
  }

  private follow(begun: number, picture: Picture | undefined): void {
    const { gl } = this;
    const sync = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    if (sync !== null) this.underWay.push({ sync, begun, picture });
  }

  /** Forget pictures of graphics that were lost. */
  forget(): void {
    this.underWay.length = 0;
  }

  private look(): void {
    const { gl, underWay } = this;
    while (underWay.length > 0 && gl.clientWaitSync(underWay[0]!.sync, 0, 0) !== gl.TIMEOUT_EXPIRED) {
      const { sync, begun, picture } = underWay.shift()!;
      gl.deleteSync(sync);
      if (picture === undefined) continue;
      this.milliseconds = performance.now() - begun;
      this.drawn = picture.splats;
      // Most of the work of slow graphics is for pixels.
      const wanted = picture.scale * Math.sqrt(SLOW_PICTURE / Math.max(this.milliseconds, 1));
      // The next one may show more splats than this one did.
      const next = Math.min(wanted, this.scale * MOST_GROWTH, 1);
      this.scale = Math.max(Math.round(next / SCALE_STEP) * SCALE_STEP, LEAST_SCALE);
    }
  }
}
