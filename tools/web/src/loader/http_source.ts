import type { ByteRange } from "../container/scene_index.js";
import { CogsplatError, SourceError } from "../errors.js";
import {
  type Answer,
  type ByteSource,
  LONGEST_PAUSE,
  lateness,
  lengthOf,
  MAX_REQUESTS,
  type ReadOptions,
  readParts,
  withinPause,
} from "./byte_source.js";

/** Options of HTTP requests. */
export interface HttpOptions {
  /** Headers of every request, for example for authorisation. */
  readonly headers?: Readonly<Record<string, string>>;
  readonly credentials?: RequestCredentials;
  /** Longest time without a byte before a retry, ms; 15,000 by default. */
  readonly longestPause?: number;
  /** Bypass caches with every request, for example after a file has changed. */
  readonly fresh?: boolean;
  /** Replacement for the global `fetch`. */
  readonly fetch?: typeof fetch;
}

/** Maximum number of requests in flight over HTTP/2 and HTTP/3, where all share one connection (SPEC 8.8). */
const MAX_SHARED_REQUESTS = 24;

/** Statuses after which a retry may succeed. */
const RETRYABLE = new Set([408, 425, 429, 500, 502, 503, 504]);

/** A file on an HTTP server; one that ignores ranges is read from the front. */
export class HttpSource implements ByteSource {
  private etag: string | undefined;
  private total: number | undefined;
  private sharesConnection: boolean | undefined;

  constructor(
    private readonly url: string | URL,
    private readonly options: HttpOptions = {},
    /** Whether all segments of the scene are at this address. */
    private readonly isWhole = true,
  ) {}

  async read(range: ByteRange, options: ReadOptions = {}): Promise<Answer> {
    const last = range.offset + range.length - 1;
    const { response, release } = await this.request(`bytes=${range.offset}-${last}`, options);
    try {
      const { total, body } = this.check(response, range);
      const whole = response.status === 200;
      const parts = readParts(body, options.signal, this.longestPause, release);
      return { offset: whole ? 0 : range.offset, total, whole, parts };
    } catch (error) {
      release();
      response.body?.cancel().catch(() => undefined);
      throw error;
    }
  }

  /**
   * Maximum number of requests in flight: 24 once the browser has told that the server speaks HTTP/2 or HTTP/3. Of
   * another origin it tells so only if the server sends `Timing-Allow-Origin`.
   */
  get mostRequests(): number {
    if (this.sharesConnection === undefined) {
      const seen = performance.getEntriesByName(this.address.href, "resource").at(-1);
      if (seen === undefined) return MAX_REQUESTS;
      this.sharesConnection = /^h[23]/.test((seen as PerformanceResourceTiming).nextHopProtocol);
    }
    return this.sharesConnection ? MAX_SHARED_REQUESTS : MAX_REQUESTS;
  }

  private get address(): URL {
    return new URL(this.url, globalThis.document?.baseURI ?? globalThis.location?.href);
  }

  /** Return a file relative to this one; it keeps the query of the address, which may hold a signature. */
  relative(name: string): HttpSource {
    const own = this.address;
    const url = new URL(name, own);
    url.search = own.search;
    return new HttpSource(url, this.options, false);
  }

  /** Send a request; the caller releases it once the body has ended or is not needed. */
  private async request(
    range: string,
    { signal, fresh, priority }: ReadOptions,
  ): Promise<{ readonly response: Response; readonly release: () => void }> {
    const { headers, credentials } = this.options;
    // Both a missing answer and the caller's signal end the request.
    const stop = new AbortController();
    const onAbort = (): void => stop.abort(signal!.reason);
    const release = (): void => signal?.removeEventListener("abort", onAbort);
    if (signal?.aborted) onAbort();
    signal?.addEventListener("abort", onAbort, { once: true });
    try {
      const answer = (this.options.fetch ?? fetch)(this.url, {
        headers: { ...headers, Range: range },
        cache: fresh || this.options.fresh ? "reload" : "default",
        ...(credentials && { credentials }),
        // Chromium's cache serialises the requests of one address, so parallel ones bypass it.
        ...(priority && { priority, ...(this.isWhole && { cache: "no-store" }) }),
        signal: stop.signal,
      });
      const response = await withinPause(answer, this.longestPause, () => lateness(this.longestPause));
      return { response, release };
    } catch (error) {
      release();
      if (signal?.aborted) throw signal.reason;
      stop.abort();
      if (error instanceof SourceError) throw error;
      // `fetch` does not tell a failed connection, an unknown name and a CORS refusal apart.
      throw new SourceError(`${String(this.url)} cannot be reached: ${String(error)}`, undefined, true);
    }
  }

  private get longestPause(): number {
    return this.options.longestPause ?? LONGEST_PAUSE;
  }

  /** Check the headers of an answer; throw an error that states what is wrong. */
  private check(
    response: Response,
    range: ByteRange,
  ): { readonly total: number | undefined; readonly body: ReadableStream<Uint8Array> } {
    const { status, headers } = response;
    const what = `bytes ${range.offset} to ${range.offset + range.length - 1} of ${String(this.url)}`;
    if (status === 416) throw new CogsplatError("source-changed", `the file ends before ${what}`);
    if (status === 412) throw new CogsplatError("source-changed", `${what}: status 412, the file is another one`);
    if (status !== 206 && status !== 200) {
      const isRetryable = RETRYABLE.has(status);
      const wait = isRetryable ? retryAfter(headers.get("Retry-After"), headers.get("Date")) : undefined;
      throw new SourceError(`${what}: status ${status}`, status, isRetryable, wait);
    }
    const encoding = headers.get("Content-Encoding");
    if (encoding !== null && encoding !== "identity") {
      throw new SourceError(`${what}: an answer with Content-Encoding ${encoding} is not of these bytes`, status);
    }
    const type = headers.get("Content-Type");
    if (status === 206 && type?.trim().toLowerCase().startsWith("multipart/byteranges")) {
      throw new SourceError(`${what}: an answer of several parts, expected one range`, status);
    }
    const contentRange = headers.get("Content-Range");
    const stated = /^bytes (\d{1,15})-(\d{1,15})\/(\d{1,15}|\*)$/.exec(contentRange ?? "");
    // Across origins the header is hidden unless the server exposes it; then the length alone is checked.
    const total = status === 200 ? lengthOf(headers) : stated && stated[3] !== "*" ? Number(stated[3]) : undefined;
    if (status === 206 && contentRange !== null) {
      const end = Math.min(range.offset + range.length, total ?? Infinity) - 1;
      // A server may send fewer bytes than requested; the rest is requested again.
      if (
        stated === null ||
        Number(stated[1]) !== range.offset ||
        Number(stated[2]) < range.offset ||
        Number(stated[2]) > end
      ) {
        throw new SourceError(`${what}: an answer of ${contentRange}`, status);
      }
    }
    const length = lengthOf(headers);
    if (status === 206 && length !== undefined && length > range.length) {
      throw new SourceError(`${what}: an answer of ${length} bytes`, status);
    }
    this.compare(headers.get("ETag"), total);
    if (response.body === null) throw new SourceError(`${what}: an answer without a body`, status, true);
    return { total, body: response.body };
  }

  /** Refuse an answer of another file than the first answer; weak ETags do not identify bytes. */
  private compare(etag: string | null, total: number | undefined): void {
    const strong = etag !== null && !etag.startsWith("W/") ? etag : undefined;
    if (
      (this.etag !== undefined && strong !== undefined && this.etag !== strong) ||
      (this.total !== undefined && total !== undefined && this.total !== total)
    ) {
      throw new CogsplatError("source-changed", `${String(this.url)} changed while it was read`);
    }
    this.etag ??= strong;
    this.total ??= total;
  }
}

/**
 * Return the wait of a `Retry-After` header, ms: seconds, or a date on the server's clock (RFC 9110, 10.2.3).
 *
 * @returns undefined for a missing or malformed header.
 */
export function retryAfter(header: string | null, date: string | null): number | undefined {
  if (header === null) return undefined;
  if (/^\d{1,9}$/.test(header.trim())) return 1000 * Number(header);
  const wait = Date.parse(header) - (date === null ? Date.now() : Date.parse(date));
  return Number.isNaN(wait) ? undefined : Math.max(0, wait);
}
