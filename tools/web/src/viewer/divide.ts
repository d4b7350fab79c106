/** Movement of the divide by an arrow key, as a share of the width. */
const KEY_STEP = 0.02;

/** The line between two scenes, moved by dragging or arrow keys. */
export class Divide {
  /** Position, as a share of the width. */
  private share = 0.5;

  constructor(
    private readonly line: HTMLElement,
    private readonly moved: (share: number) => void,
    signal: AbortSignal,
  ) {
    line.addEventListener("pointerdown", (event) => line.setPointerCapture(event.pointerId), { signal });
    line.addEventListener(
      "pointermove",
      (event) => {
        if (!line.hasPointerCapture(event.pointerId)) return;
        const { left, width } = line.parentElement!.getBoundingClientRect();
        this.place((event.clientX - left) / width);
      },
      { signal },
    );
    line.addEventListener(
      "keydown",
      (event) => {
        const step = { ArrowLeft: -KEY_STEP, ArrowRight: KEY_STEP, Home: -1, End: 1 }[event.key];
        if (step === undefined) return;
        event.preventDefault();
        event.stopPropagation();
        this.place(this.share + step);
      },
      { signal },
    );
  }

  /** Show or hide the line. */
  set shown(shown: boolean) {
    this.line.hidden = !shown;
    if (shown) this.place(this.share);
  }

  private place(share: number): void {
    this.share = Math.min(Math.max(share, 0), 1);
    this.line.style.left = `${100 * this.share}%`;
    this.line.setAttribute("aria-valuenow", String(Math.round(100 * this.share)));
    this.moved(this.share);
  }
}
