import type { ByteRange } from "../container/scene_index.js";
import { windowBytes } from "../schedule/scheduler.js";
import { LinkEstimate } from "./link_estimate.js";
import { nextRequest } from "./range_plan.js";
import type { RetryingReader } from "./retrying_reader.js";

/** Most requests under way (SPEC 8.8). */
const MAX_REQUESTS = 6;
/** Bytes of a request, at most, on a connection that needs no longer ones: what is asked for together is stopped together. */
const REQUEST_BYTES = 65_536;

/** Receives what requests bring. */
export interface UnitReceiver {
  /** A unit has come whole. */
  came(unit: number, payload: Uint8Array): void;
  /** Units cannot be had. */
  failed(error: unknown, units: readonly number[]): void;
  /** A request has ended. */
  ended(): void;
}

interface Request {
  /** Units that have not come whole, in the order in which they will. */
  readonly left: number[];
  readonly abort: AbortController;
}

/** Requests of units, which can be stopped and go on later from the byte where they were. */
export class UnitRequests {
  readonly link = new LinkEstimate();
  /** Bytes that have come of units that are not whole. */
  readonly received = new Map<number, number>();
  private readonly parts = new Map<number, Uint8Array>();
  private readonly requests = new Set<Request>();

  constructor(
    private readonly reader: RetryingReader,
    /** Where a unit is in what is read. */
    private readonly rangeOf: (unit: number) => ByteRange,
    private readonly receiver: UnitReceiver,
  ) {}

  /** Units that are asked for. */
  get underWay(): number[] {
    return [...this.requests].flatMap(({ left }) => left);
  }

  /** Whether one more request may be made: answers share the connection, so that the first would wait for all others. */
  private get hasRoom(): boolean {
    const { bytesPerSecond, latency } = this.link;
    const toCome = this.underWay.reduce((sum, unit) => sum + this.rest(unit).length, 0);
    return (
      this.requests.size === 0 || (this.requests.size < MAX_REQUESTS && toCome < windowBytes(bytesPerSecond, latency))
    );
  }

  /**
   * Ask for units, those that lie beside each other together, until as much is under way as keeps the connection busy.
   *
   * @param wanted - In the order in which they are wanted.
   * @param priority - Of `fetch`, of a request whose first unit it is given.
   */
  start(wanted: readonly number[], priority: (unit: number) => RequestPriority): void {
    const left = [...wanted];
    const { bytesPerSecond, latency } = this.link;
    // Fast connections are filled by longer requests.
    const most = Math.max(REQUEST_BYTES, (bytesPerSecond * latency) / MAX_REQUESTS);
    while (left.length > 0 && this.hasRoom) {
      const range = nextRequest(left, this.rest, most, 0)!;
      const request = { left: [...range.segments], abort: new AbortController() };
      this.requests.add(request);
      void this.run(request, range, priority(range.segments[0]!));
    }
  }

  /**
   * Stop units, and those that were asked for together with one of them; what has come of them stays.
   *
   * @returns How many units were stopped.
   */
  stop(units: readonly number[]): number {
    let stopped = 0;
    for (const request of this.requests) {
      if (!request.left.some((unit) => units.includes(unit))) continue;
      this.requests.delete(request);
      request.abort.abort();
      stopped += request.left.length;
    }
    return stopped;
  }

  /** Stop all. */
  close(): void {
    this.stop(this.underWay);
  }

  /** Forget what has come of a unit. */
  forget(unit: number): void {
    this.parts.delete(unit);
    this.received.delete(unit);
  }

  /** What is still to come of a unit. */
  private readonly rest = (unit: number): ByteRange => {
    const { offset, length } = this.rangeOf(unit);
    const had = this.received.get(unit) ?? 0;
    return { offset: offset + had, length: length - had };
  };

  private async run(request: Request, range: ByteRange, priority: RequestPriority): Promise<void> {
    const {
      left,
      abort: { signal },
    } = request;
    const asked = performance.now();
    let isFirst = true;
    try {
      await this.reader.parts(
        range,
        signal,
        (part) => {
          if (signal.aborted) return;
          const now = performance.now();
          if (isFirst) this.link.answered((now - asked) / 1000);
          isFirst = false;
          this.link.came(part.length, now / 1000);
          this.take(part, left);
        },
        priority,
      );
    } catch (error) {
      if (signal.aborted) return;
      this.receiver.failed(error, left);
    }
    if (signal.aborted) return;
    this.requests.delete(request);
    if (this.requests.size === 0) this.link.rest();
    this.receiver.ended();
  }

  /** Share a part of an answer out among the units that are still to come of it, which lie beside each other. */
  private take(part: Uint8Array, left: number[]): void {
    let rest = part;
    while (rest.length > 0) {
      const unit = left[0]!;
      const { length } = this.rangeOf(unit);
      const bytes = this.parts.get(unit) ?? new Uint8Array(length);
      const had = this.received.get(unit) ?? 0;
      const used = rest.subarray(0, length - had);
      bytes.set(used, had);
      rest = rest.subarray(used.length);
      if (had + used.length < length) {
        this.parts.set(unit, bytes);
        this.received.set(unit, had + used.length);
        return;
      }
      left.shift();
      this.forget(unit);
      this.receiver.came(unit, bytes);
    }
  }
}
