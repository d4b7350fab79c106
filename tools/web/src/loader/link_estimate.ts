/** Assumed throughput before the first measurement, bytes per second: 2 Mbit/s. */
const FIRST_RATE = 250_000;
/** Assumed latency before the first answer, seconds. */
const FIRST_LATENCY = 0.1;
/** Length of the measured window, seconds. */
const REMEMBERED = 1;
/** Parts within this time count as one, seconds. */
const MERGED_SECONDS = 0.001;
/** Fewest bytes and seconds that give a throughput. */
const LEAST_BYTES = 16_384;
const LEAST_SECONDS = 0.01;

/** Estimate of a connection's throughput and latency from recent answers (docs/streaming.md, 11). */
export class LinkEstimate {
  bytesPerSecond = FIRST_RATE;
  private readonly parts: { readonly seconds: number; bytes: number }[] = [];
  private shortest = Infinity;

  /**
   * Time from a request to its first byte, seconds: the minimum so far, because longer ones queued behind other
   * answers.
   */
  get latency(): number {
    return Number.isFinite(this.shortest) ? this.shortest : FIRST_LATENCY;
  }

  /** Record the latency of an answer, seconds. */
  recordLatency(seconds: number): void {
    this.shortest = Math.min(this.shortest, seconds);
  }

  /** Record received bytes and their time, seconds. */
  recordBytes(bytes: number, seconds: number): void {
    const { parts } = this;
    const last = parts.at(-1);
    // A peer may send any number of parts of a byte.
    if (last !== undefined && seconds - last.seconds < MERGED_SECONDS) last.bytes += bytes;
    else parts.push({ seconds, bytes });
    while (parts[0]!.seconds < seconds - REMEMBERED) parts.shift();
    // The bytes of the first part arrived before its time.
    const [first] = parts;
    const sum = parts.reduce((all, part) => all + part.bytes, -first!.bytes);
    const passed = seconds - first!.seconds;
    if (sum >= LEAST_BYTES && passed >= LEAST_SECONDS) this.bytesPerSecond = sum / passed;
  }

  /** Record that no request is in flight, so that the pause does not count. */
  pause(): void {
    this.parts.length = 0;
  }
}
