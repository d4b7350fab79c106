/** What a connection is taken to bring before anything was measured, bytes a second: 2 Mbit/s. */
const FIRST_RATE = 250_000;
/** What the latency is taken to be before an answer has come, seconds. */
const FIRST_LATENCY = 0.1;
/** How much of the past is looked at, seconds. */
const REMEMBERED = 1;
/** Bytes and seconds below which a rate says nothing. */
const LEAST_BYTES = 16_384;
const LEAST_SECONDS = 0.01;

/** What a connection brings, by what has come lately (docs/streaming.md, 11). */
export class LinkEstimate {
  bytesPerSecond = FIRST_RATE;
  private readonly parts: { readonly seconds: number; readonly bytes: number }[] = [];
  private shortest = Infinity;

  /** Seconds from a request to its first byte: the shortest time so far, for longer ones waited behind other answers. */
  get latency(): number {
    return Math.min(this.shortest, FIRST_LATENCY);
  }

  /** Note how long a request had waited when its first byte came. */
  answered(seconds: number): void {
    this.shortest = Math.min(this.shortest, seconds);
  }

  /** Note bytes that have come at a time. */
  came(bytes: number, seconds: number): void {
    const { parts } = this;
    parts.push({ seconds, bytes });
    while (parts[0]!.seconds < seconds - REMEMBERED) parts.shift();
    // The bytes of the first part came before its time.
    const [first] = parts;
    const sum = parts.reduce((all, part) => all + part.bytes, -first!.bytes);
    const passed = seconds - first!.seconds;
    if (sum >= LEAST_BYTES && passed >= LEAST_SECONDS) this.bytesPerSecond = sum / passed;
  }

  /** Note that nothing is under way, so that the pause does not count. */
  rest(): void {
    this.parts.length = 0;
  }
}
