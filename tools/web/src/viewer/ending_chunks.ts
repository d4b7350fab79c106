/** How long a chunk that has ended goes on fading, ms; SPEC 8.6 allows a second. */
const FADE_MILLISECONDS = 400;

interface EndingChunk {
  hidden: boolean;
  /** When it began to fade; undefined where it does not. */
  since: number | undefined;
}

/** Chunks that are there for the first seconds alone (SPEC 5.10): each fades when it has ended. */
export class EndingChunks {
  private readonly chunks = new Map<number, EndingChunk>();

  /**
   * @param isDrawn - Whether a prefix draws a chunk.
   * @param paint - Draws a chunk with its opacities times a factor, 0 to 1.
   */
  constructor(
    private readonly isDrawn: (chunk: number, prefix: number) => boolean,
    private readonly paint: (chunk: number, factor: number) => void,
  ) {}

  /** Note that a chunk has come, for the first time or with more, and stands in the picture with all its opacity. */
  put(chunk: number, prefix: number): void {
    const entry = this.chunks.get(chunk) ?? { hidden: !this.isDrawn(chunk, prefix), since: undefined };
    this.chunks.set(chunk, entry);
    if (entry.hidden && entry.since === undefined) this.paint(chunk, 0);
  }

  /**
   * Draw what a prefix draws.
   *
   * @param fadesFrom - When what has ended begins to fade; undefined to leave it out at once.
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

  /** Fade on; returns whether there is something left that fades. */
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
