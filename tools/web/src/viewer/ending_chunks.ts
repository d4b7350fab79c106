/** Duration of the fade of a chunk that has ended, ms; SPEC 8.6 allows a second. */
const FADE_MILLISECONDS = 400;

interface EndingChunk {
  hidden: boolean;
  /** Start of its fade; undefined before. */
  since: number | undefined;
}

/** Chunks for the first seconds alone (SPEC 5.10), which fade when they end. */
export class EndingChunks {
  private readonly chunks = new Map<number, EndingChunk>();

  /**
   * @param isDrawn - Returns whether a prefix draws a chunk.
   * @param paint - Draws a chunk with its opacities multiplied by a factor from 0 to 1.
   */
  constructor(
    private readonly isDrawn: (chunk: number, prefix: number) => boolean,
    private readonly paint: (chunk: number, factor: number) => void,
  ) {}

  /** Add a chunk, or an update of it, that is drawn with full opacity. */
  put(chunk: number, prefix: number): void {
    const entry = this.chunks.get(chunk) ?? { hidden: !this.isDrawn(chunk, prefix), since: undefined };
    this.chunks.set(chunk, entry);
    if (entry.hidden && entry.since === undefined) this.paint(chunk, 0);
  }

  /**
   * Draw the chunks of a prefix.
   *
   * @param fadesFrom - Time at which ended chunks begin to fade; undefined hides them at once.
   */
  show(prefix: number, fadesFrom: number | undefined): void {
    for (const [chunk, entry] of this.chunks) {
      const hidden = !this.isDrawn(chunk, prefix);
      const isEnded = hidden && entry.since !== undefined && fadesFrom === undefined;
      if (hidden === entry.hidden && !isEnded) continue;
      entry.hidden = hidden;
      entry.since = hidden ? fadesFrom : undefined;
      if (entry.since === undefined) this.paint(chunk, hidden ? 0 : 1);
    }
  }

  /** Advance the fades; return whether any is left. */
  work(now: number): boolean {
    let fades = false;
    for (const [chunk, entry] of this.chunks) {
      if (entry.since === undefined) continue;
      const factor = Math.min(Math.max(1 - (now - entry.since) / FADE_MILLISECONDS, 0), 1);
      this.paint(chunk, factor);
      if (factor === 0) entry.since = undefined;
      else fades = true;
    }
    return fades;
  }

  clear(): void {
    this.chunks.clear();
  }
}
