import type { HttpOptions } from "../src/loader/http_source.js";

/** What one answer does wrong; a case is a list of these, so that it can be kept as JSON. */
export interface Fault {
  /** Status instead of 206. */
  readonly status?: number;
  /** Headers set or, where null, left out. */
  readonly headers?: Readonly<Record<string, string | null>>;
  /** Whether the whole file is sent with status 200. */
  readonly whole?: boolean;
  /** Added to first and last byte and to the length of the file in Content-Range. */
  readonly shift?: readonly [number, number, number];
  /** Bytes of an answer at most; its headers say so. */
  readonly most?: number;
  /** Whether the bytes are those of a second file. */
  readonly other?: boolean;
  /** Bytes of the body that are changed: place and mask. */
  readonly flips?: readonly (readonly [number, number])[];
  /** Number of bytes after which the body ends. */
  readonly end?: number;
  /** How a body that ends early ends: properly, by an error of the connection, or never. */
  readonly ending?: "close" | "error" | "stall";
  /** Number of bytes behind the body; −1 for a body without end. */
  readonly behind?: number;
  /** Bytes of each part of the body. */
  readonly part?: number;
  /** Time before each part, ms. */
  readonly pause?: number;
  /** Time before the answer, ms. */
  readonly delay?: number;
  /** What takes the place of an answer: a rejection, or nothing ever. */
  readonly instead?: "TypeError" | "RangeError" | "text" | "nothing";
  /** Whether the answer has no body. */
  readonly empty?: boolean;
}

/** Length of the parts of a body, bytes. */
const PART = 16_384;

/** A server of one file behind the signature of `fetch`, with a fault for each request. */
export class ScriptedServer {
  /** Ranges requested, in order. */
  readonly ranges: [number, number][] = [];
  /** Bytes that the client has taken. */
  bytes = 0;
  /** Bodies that have neither ended nor been cancelled. */
  open = 0;

  /**
   * @param file - The file.
   * @param faultOf - Fault of request `number`, counted from 0.
   * @param other - Another file, for answers of the wrong file.
   */
  constructor(
    private readonly file: Uint8Array,
    private readonly faultOf: (number: number) => Fault | undefined = () => undefined,
    private readonly other: Uint8Array = file,
  ) {}

  /** Options of a source whose requests are answered here. */
  get http(): HttpOptions {
    return { fetch: this.fetch };
  }

  private readonly fetch = async (_: unknown, init?: RequestInit): Promise<Response> => {
    const [, from, to] = /^bytes=(\d+)-(\d+)$/.exec(new Headers(init?.headers).get("Range")!)!;
    const fault = this.faultOf(this.ranges.length) ?? {};
    this.ranges.push([Number(from), Number(to)]);
    const signal = init?.signal ?? undefined;
    if (fault.delay) await wait(fault.delay, signal);
    if (fault.instead === "nothing") await wait(Infinity, signal);
    if (fault.instead === "text") throw "a text";
    if (fault.instead) throw fault.instead === "TypeError" ? new TypeError("fetch failed") : new RangeError("a range");
    return this.answer(Number(from), Number(to), fault, signal);
  };

  private answer(from: number, to: number, fault: Fault, signal: AbortSignal | undefined): Response {
    const file = fault.other ? this.other : this.file;
    const total = file.length;
    const status = fault.status ?? (fault.whole ? 200 : from >= total ? 416 : 206);
    const first = fault.whole ? 0 : from;
    const body = file.slice(first, fault.whole ? total : Math.min(to + 1, total, from + (fault.most ?? Infinity)));
    for (const [place, mask] of fault.flips ?? []) if (body.length > 0) body[place % body.length]! ^= mask;
    const [more, later, longer] = fault.shift ?? [0, 0, 0];
    const headers = new Headers({ ETag: fault.other ? '"b"' : '"a"', "Content-Length": `${body.length}` });
    if (!fault.whole) {
      headers.set("Content-Range", `bytes ${first + more}-${first + body.length - 1 + later}/${total + longer}`);
    }
    for (const [name, value] of Object.entries(fault.headers ?? {})) {
      if (value === null) headers.delete(name);
      else headers.set(name, value);
    }
    const hasBody = !fault.empty && ![101, 204, 205, 304].includes(status);
    return new Response(hasBody ? this.stream(body, fault, signal) : null, { status, headers });
  }

  /** Return the body of an answer, which breaks off with the request as the bodies of `fetch` do. */
  private stream(body: Uint8Array, fault: Fault, signal: AbortSignal | undefined): ReadableStream<Uint8Array> {
    const { part = PART, pause = 0, behind = 0 } = fault;
    const end = Math.min(fault.end ?? Infinity, body.length);
    let at = 0;
    let extra = end < body.length ? 0 : behind;
    let isOpen = true;
    this.open++;
    const close = (): void => {
      if (isOpen) this.open--;
      isOpen = false;
    };
    return new ReadableStream<Uint8Array>(
      {
        start: (controller) => {
          const broken = (): void => {
            if (isOpen) controller.error(signal!.reason);
            close();
          };
          if (signal?.aborted) broken();
          signal?.addEventListener("abort", broken, { once: true });
        },
        pull: async (controller) => {
          if (pause > 0) await wait(pause, undefined);
          if (!isOpen) return;
          if (at < end) {
            const next = body.slice(at, Math.min(at + part, end));
            at += next.length;
            this.bytes += next.length;
            controller.enqueue(next);
          } else if (extra !== 0) {
            const length = extra < 0 ? part : Math.min(part, extra);
            if (extra > 0) extra -= length;
            this.bytes += length;
            controller.enqueue(new Uint8Array(length));
          } else if (fault.ending === "stall" && end < body.length) {
            await wait(Infinity, signal);
          } else {
            close();
            if (fault.ending === "error" && end < body.length) controller.error(new TypeError("terminated"));
            else controller.close();
          }
        },
        cancel: close,
      },
      { highWaterMark: 0 },
    );
  }
}

/** Wait for a time, ms, or until a signal is aborted; then reject with its reason. */
async function wait(milliseconds: number, signal: AbortSignal | undefined): Promise<void> {
  await new Promise<void>((resolve, reject) => {
    const aborted = (): void => {
      clearTimeout(timer);
      reject(signal!.reason as Error);
    };
    const timer =
      milliseconds === Infinity
        ? undefined
        : setTimeout(() => {
            signal?.removeEventListener("abort", aborted);
            resolve();
          }, milliseconds);
    if (signal?.aborted) aborted();
    else signal?.addEventListener("abort", aborted, { once: true });
  });
}
