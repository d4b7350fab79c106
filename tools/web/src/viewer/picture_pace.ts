/** Duration from which pictures count as slow, ms. */
const SLOW_PICTURE = 45;
/** Smallest reduced resolution, as a share of each side. */
const LEAST_SCALE = 0.4;
/** Maximum factor by which that share grows from one picture to the next. */
const MOST_GROWTH = 1.5;
/** Maximum factor of the expected duration for more splats; part of the duration is constant. */
const MOST_LONGER = 10;
/** Expected duration of the first picture, ms. */
const FIRST_PICTURE = 100;
/** Step of the share, because every change allocates textures. */
const SCALE_STEP = 0.05;

/** A picture: its resolution as a share of each side, and its splats. */
interface Picture {
  readonly scale: number;
  readonly splats: number;
}

/** Commands submitted to the GPU, with the fence that follows them. */
interface UnderWay {
  readonly sync: WebGLSync;
  readonly begun: number;
  readonly picture: Picture | undefined;
}

/**
 * Tracks the pictures that the GPU is drawing, so that no more are begun than it finishes: queued pictures would be
 * outdated, and full queues block the page.
 */
export class PicturePace {
  /** Duration of the last picture, from its first command to the end of its GPU work, ms. */
  milliseconds = 0;
  /** Reduced resolution as a share of each side; low until the first duration is known. */
  scale = LEAST_SCALE;
  /** Splats of the next picture. */
  splats = 0;
  /** Splats of the last picture. */
  private drawn = 0;
  private readonly underWay: UnderWay[] = [];

  constructor(private readonly gl: WebGL2RenderingContext) {}

  /** Expected duration of the next picture, ms, estimated from the last picture and the numbers of splats. */
  get expected(): number {
    if (this.milliseconds === 0) return FIRST_PICTURE;
    return this.milliseconds * Math.min(Math.max(this.splats / Math.max(this.drawn, 1), 1), MOST_LONGER);
  }

  /** Whether the next picture is expected to take longer than `SLOW_PICTURE`. */
  get isSlow(): boolean {
    return this.expected > SLOW_PICTURE;
  }

  /** Whether no picture is in progress. */
  get isIdle(): boolean {
    this.poll();
    return this.underWay.length === 0;
  }

  /** Whether another picture may begin; a fast GPU draws one while the next is prepared. */
  get isFree(): boolean {
    this.poll();
    return this.underWay.length < (this.isSlow ? 1 : 2);
  }

  /**
   * Record that the commands of a picture were submitted.
   *
   * @param begun - Time of the first command, from `performance.now`.
   */
  submitted(begun: number, picture: Picture): void {
    this.follow(begun, picture);
  }

  /** Record an upload of textures, which takes GPU time as well. */
  uploads(): void {
    this.follow(performance.now(), undefined);
  }

  /** Insert a fence after the commands submitted so far, to learn when the GPU has finished them. */
  private follow(begun: number, picture: Picture | undefined): void {
    const { gl } = this;
    const sync = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    if (sync !== null) this.underWay.push({ sync, begun, picture });
  }

  /** Forget the pictures in progress after the WebGL context is lost. */
  forget(): void {
    this.underWay.length = 0;
  }

  /** Remove the pictures that the GPU has finished; set the resolution of the next picture by their duration. */
  private poll(): void {
    const { gl, underWay } = this;
    while (underWay.length > 0 && gl.clientWaitSync(underWay[0]!.sync, 0, 0) !== gl.TIMEOUT_EXPIRED) {
      const { sync, begun, picture } = underWay.shift()!;
      gl.deleteSync(sync);
      if (picture === undefined) continue;
      this.milliseconds = performance.now() - begun;
      this.drawn = picture.splats;
      // On a slow GPU the duration is mostly proportional to the number of pixels.
      const wanted = picture.scale * Math.sqrt(SLOW_PICTURE / Math.max(this.milliseconds, 1));
      // The next picture may have more splats.
      const next = Math.min(wanted, this.scale * MOST_GROWTH, 1);
      this.scale = Math.max(Math.round(next / SCALE_STEP) * SCALE_STEP, LEAST_SCALE);
    }
  }
}
