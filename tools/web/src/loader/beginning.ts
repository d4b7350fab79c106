import type { RetryingReader } from "./retrying_reader.js";

/** The first bytes of a file, shared by all fetches of a scene and readable as they arrive. */
export class Beginning {
  private readonly bytes: Uint8Array;
  private received = 0;
  /** Whether the request is complete: all bytes have arrived, or the file is shorter. */
  private ended = false;
  /** Length of the whole file, if the source states it. */
  total: number | undefined;
  /** Whether the source sends the whole file for every range. */
  sequential = false;
  private filling: Promise<void> | undefined;
  /** Number of callers that wait. */
  private waiting = 0;
  private abort = new AbortController();
  private wake: () => void = () => undefined;
  private arrival = this.nextArrival();

  constructor(
    private readonly reader: RetryingReader,
    /** Length of the beginning, bytes; a shorter file gives fewer. */
    readonly length: number,
  ) {
    this.bytes = new Uint8Array(length);
  }

  /** Bytes received so far. */
  get available(): Uint8Array {
    return this.bytes.subarray(0, this.received);
  }

  /** Return whether a range up to `end` is part of the beginning. */
  holds(end: number): boolean {
    return end <= (this.ended ? this.received : Math.min(this.length, this.total ?? this.length));
  }

  /** Wait until `length` bytes are received or the file has ended; start the request if none is running. */
  async waitFor(length: number, signal: AbortSignal | undefined): Promise<void> {
    const stop = (): void => this.stop();
    signal?.addEventListener("abort", stop, { once: true });
    this.waiting++;
    try {
      while (this.received < length && !this.ended) {
        signal?.throwIfAborted();
        this.filling ??= this.fill();
        await Promise.race([this.filling, this.arrival]);
      }
    } finally {
      this.waiting--;
      signal?.removeEventListener("abort", stop);
    }
  }

  /** Stop the request; a waiting caller starts it again from the next byte. */
  stop(): void {
    this.abort.abort();
  }

  /** Stop the request unless a caller waits for it; called at the end of a fetch. */
  release(): void {
    if (this.waiting === 0) this.stop();
  }

  private nextArrival(): Promise<void> {
    return new Promise((resolve) => (this.wake = resolve));
  }

  private fill(): Promise<void> {
    this.abort = new AbortController();
    const { signal } = this.abort;
    const filled = this.reader.readBeginning({ offset: this.received, length: this.length - this.received }, signal, {
      begin: ({ total, whole }) => {
        this.total ??= total;
        this.sequential ||= whole;
      },
      take: (part) => {
        this.bytes.set(part, this.received);
        this.received += part.length;
        this.wake();
        this.arrival = this.nextArrival();
      },
    });
    const done = filled.then(
      () => {
        this.ended = true;
        this.filling = undefined;
      },
      (error: unknown) => {
        this.filling = undefined;
        if (!signal.aborted) throw error;
      },
    );
    // Without a waiting caller the error is dropped; the next caller starts the request again.
    done.catch(() => undefined);
    return done;
  }
}
