import type { ByteRange } from "../container/scene_index.js";
import { windowBytes } from "../schedule/scheduler.js";
import { GrowingBytes } from "./byte_source.js";
import { LinkEstimate } from "./link_estimate.js";
import { nextRequest, type RangeRequest } from "./range_plan.js";
import type { RetryingReader } from "./retrying_reader.js";

/** Bytes of stopped segments kept at most: without a limit those of a city would fill the memory. */
const MOST_PARTIAL_BYTES = 4 << 20;
/** Maximum size of a request, bytes, except on fast connections; short, because a request is stopped as a whole. */
const REQUEST_BYTES = 65_536;

/** Handlers of received segments, failed requests and ended requests. */
export interface SegmentReceiver {
  /** Called with each complete segment. */
  received(segment: number, payload: Uint8Array): void;
  /** Called with the incomplete segments of a request that failed after all retries. */
  failed(error: unknown, segments: readonly number[]): void;
  /** Called after the end of each request. */
  ended(): void;
}

interface Request {
  /** Incomplete segments, in file order. */
  readonly left: number[];
  readonly abort: AbortController;
  /** Offset of the next byte of the answer. */
  position: number;
}

/** Range requests in flight; a stopped segment is resumed later from its first missing byte. */
export class SegmentRequests {
  readonly link = new LinkEstimate();
  /** Received bytes of each incomplete segment. */
  private readonly parts = new Map<number, GrowingBytes>();
  private readonly requests = new Set<Request>();

  /** @param rangeOf - Byte range of a segment in the source of `reader`. */
  constructor(
    private readonly reader: RetryingReader,
    private readonly rangeOf: (segment: number) => ByteRange,
    private readonly receiver: SegmentReceiver,
  ) {}

  /** Number of bytes received of each incomplete segment. */
  get partial(): Map<number, number> {
    return new Map([...this.parts].map(([segment, bytes]) => [segment, bytes.length]));
  }

  /** Number of requests in flight. */
  get count(): number {
    return this.requests.size;
  }

  /** Incomplete segments of the requests in flight. */
  get inFlight(): number[] {
    return [...this.requests].flatMap(({ left }) => left);
  }

  /** Whether the connection has room for another request; more requests than it needs only delay the first. */
  private hasRoom(mostRequests: number): boolean {
    const { bytesPerSecond, latency } = this.link;
    const toCome = this.inFlight.reduce((sum, segment) => sum + this.missing(segment).length, 0);
    return this.count === 0 || (this.count < mostRequests && toCome < windowBytes(bytesPerSecond, latency));
  }

  /**
   * Request segments until the bytes in flight fill the connection; adjacent segments share a request.
   *
   * @param wanted - Segments, the most urgent first.
   * @param priority - `fetch` priority of a request that begins with this segment.
   */
  fillConnection(wanted: readonly number[], priority: (segment: number) => RequestPriority): void {
    const left = [...wanted];
    const { bytesPerSecond, latency } = this.link;
    const { mostRequests } = this.reader;
    // Fast connections are filled by longer requests.
    const most = Math.max(REQUEST_BYTES, (bytesPerSecond * latency) / mostRequests);
    while (left.length > 0 && this.hasRoom(mostRequests)) {
      const range = nextRequest(left, this.missing, most, 0)!;
      this.start(range, priority(range.segments[0]!));
    }
  }

  /** Start one request. */
  start(range: RangeRequest, priority?: RequestPriority): void {
    const request = { left: [...range.segments], abort: new AbortController(), position: range.offset };
    this.requests.add(request);
    void this.run(request, range, priority);
  }

  /**
   * Stop the requests that contain any of some segments; bytes already received are kept.
   *
   * @returns Number of segments stopped, including the other segments of these requests.
   */
  stop(segments: readonly number[]): number {
    let stopped = 0;
    for (const request of this.requests) {
      if (!request.left.some((segment) => segments.includes(segment))) continue;
      this.requests.delete(request);
      request.abort.abort();
      stopped += request.left.length;
    }
    this.limitPartial();
    return stopped;
  }

  /** Drop the received bytes of the segments stopped first, beyond `MOST_PARTIAL_BYTES`. */
  private limitPartial(): void {
    let bytes = 0;
    for (const { length } of this.parts.values()) bytes += length;
    const inFlight = new Set(this.inFlight);
    for (const [segment, { length }] of this.parts) {
      if (bytes <= MOST_PARTIAL_BYTES) return;
      if (inFlight.has(segment)) continue;
      this.parts.delete(segment);
      bytes -= length;
    }
  }

  /** Stop all requests. */
  close(): void {
    this.stop(this.inFlight);
  }

  /** Drop the received bytes of an incomplete segment. */
  forget(segment: number): void {
    this.parts.delete(segment);
  }

  /** Byte range still missing of a segment. */
  private readonly missing = (segment: number): ByteRange => {
    const { offset, length } = this.rangeOf(segment);
    const had = this.parts.get(segment)?.length ?? 0;
    return { offset: offset + had, length: length - had };
  };

  /** Send a request and deliver the segments of its answer; report its failure and its end to the receiver. */
  private async run(request: Request, range: ByteRange, priority: RequestPriority | undefined): Promise<void> {
    const { signal } = request.abort;
    const start = performance.now();
    let isFirst = true;
    const receive = (part: Uint8Array): void => {
      if (signal.aborted) return;
      const now = performance.now();
      if (isFirst) this.link.recordLatency((now - start) / 1000);
      isFirst = false;
      this.link.recordBytes(part.length, now / 1000);
      this.distribute(part, request);
    };
    try {
      await this.reader.readParts(range, signal, receive, priority);
    } catch (error) {
      if (signal.aborted) return;
      this.requests.delete(request);
      this.receiver.failed(error, request.left);
    }
    if (signal.aborted) return;
    this.requests.delete(request);
    if (this.requests.size === 0) this.link.pause();
    this.receiver.ended();
  }

  /** Distribute the next bytes of an answer among its segments. */
  private distribute(part: Uint8Array, request: Request): void {
    const { left } = request;
    let rest = part;
    while (rest.length > 0 && left.length > 0) {
      const segment = left[0]!;
      const { offset, length } = this.missing(segment);
      const gap = Math.min(offset - request.position, rest.length);
      const used = rest.subarray(gap, gap + length);
      rest = rest.subarray(gap + used.length);
      request.position += gap + used.length;
      const bytes = this.parts.get(segment) ?? new GrowingBytes(this.rangeOf(segment).length);
      bytes.push(used);
      if (bytes.isComplete) this.complete(segment, bytes.take(), request);
      else this.parts.set(segment, bytes);
    }
  }

  /** Deliver a segment, and the segments that share its bytes in an object of a folder. */
  private complete(segment: number, bytes: Uint8Array, { left, position }: Request): void {
    let next: number | undefined = segment;
    while (next !== undefined && (next === segment || this.rangeOf(next).offset < position)) {
      this.forget(left.shift()!);
      this.receiver.received(next, bytes);
      [next] = left;
    }
  }
}
