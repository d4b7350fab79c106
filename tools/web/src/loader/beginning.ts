import type { RetryingReader } from "./retrying_reader.js";

/** The first bytes of a file, held for all streams of a scene; the first of them are used before the last have come. */
export class Beginning {
  private readonly bytes: Uint8Array;
  private received = 0;
  /** Nothing more will come: all is there, or the file is shorter. */
  private ended = false;
  /** Length of the whole file, where the source says so. */
  total: number | undefined;
  /** Whether the source gives the whole file whatever it is asked for. */
  sequential = false;
  private filling: Promise<void> | undefined;
  private abort = new AbortController();
  private wake: () => void = () => undefined;
  private arrival = this.nextArrival();

  constructor(
    private readonly reader: RetryingReader,
    /** Bytes to ask for; fewer come where the file is shorter. */
    readonly length: number,
  ) {
    this.bytes = new Uint8Array(length);
  }

  /** The bytes that are there. */
  get here(): Uint8Array {
    return this.bytes.subarray(0, this.received);
  }

  /** Whether a range will be here when the request has ended. */
  holds(end: number): boolean {
    return end <= (this.ended ? this.received : Math.min(this.length, this.total ?? this.length));
  }

  /** Wait until so many bytes are here, or the file has ended before; they are asked for where nobody has yet. */
  async upTo(length: number, signal: AbortSignal | undefined): Promise<void> {
    const stop = (): void => this.stop();
    signal?.addEventListener("abort", stop, { once: true });
    try {
      while (this.received < length && !this.ended) {
        signal?.throwIfAborted();
        this.filling ??= this.fill();
        await Promise.race([this.filling, this.arrival]);
      }
    } finally {
      signal?.removeEventListener("abort", stop);
    }
  }

  /** End the request; whoever still waits for bytes asks for the rest again. */
  stop(): void {
    this.abort.abort();
  }

  private nextArrival(): Promise<void> {
    return new Promise((resolve) => (this.wake = resolve));
  }

  private fill(): Promise<void> {
    this.abort = new AbortController();
    const { signal } = this.abort;
    const filled = this.reader.beginning({ offset: this.received, length: this.length - this.received }, signal, {
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
    // It goes on when nobody waits; who waits next asks again and is told.
    done.catch(() => undefined);
    return done;
  }
}
