import { createServer, type IncomingMessage, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";

/** Fault of one request; undefined for none. */
export type Fault =
  | "status-503"
  | "status-403"
  | "status-404"
  | "status-416"
  | "status-500"
  | "retry-after"
  | "shorter"
  | "16-kib"
  | "weak-etag"
  | "cut"
  | "flip"
  | "wrong-range"
  | "gzip"
  | "other-etag"
  | "ignore-range"
  | "hang"
  | "stall"
  | undefined;

/** A server of one file that answers ranges, and does what a test asks to single requests. */
export class RangeServer {
  /** Ranges that were asked for, in order. */
  readonly ranges: [number, number][] = [];
  private readonly server = createServer((request, response) => this.answer(request, response));

  constructor(
    private readonly file: Uint8Array,
    /** The fault of request `number`, counted from 0. */
    private readonly fault: (number: number, range: readonly [number, number]) => Fault = () => undefined,
  ) {}

  /** Listen on a free port; gives the file's URL. */
  async start(): Promise<string> {
    await new Promise<void>((resolve) => this.server.listen(0, "127.0.0.1", resolve));
    return `http://127.0.0.1:${(this.server.address() as AddressInfo).port}/scene.cogs`;
  }

  async stop(): Promise<void> {
    this.server.closeAllConnections();
    await new Promise((resolve) => this.server.close(resolve));
  }

  private answer(request: IncomingMessage, response: ServerResponse): void {
    const asked = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
    const start = Number(asked?.[1] ?? 0);
    const end = Math.min(Number(asked?.[2] ?? Infinity), this.file.length - 1);
    const fault = this.fault(this.ranges.length, [start, end]);
    this.ranges.push([start, end]);
    const total = this.file.length;
    const body = Buffer.from(this.file.slice(start, end + 1));
    const etags: Partial<Record<string, string>> = { "other-etag": '"b"', "weak-etag": `W/"${this.ranges.length}"` };
    response.setHeader("ETag", etags[fault ?? ""] ?? '"a"');
    switch (fault) {
      case "hang":
        return;
      case "status-403":
      case "status-404":
      case "status-416":
      case "status-500":
      case "status-503":
        response.writeHead(Number(fault.slice(-3))).end();
        return;
      case "shorter":
      case "16-kib": {
        const part = body.subarray(0, fault === "16-kib" ? 16_384 : Math.ceil(body.length / 2));
        response
          .writeHead(206, {
            "Content-Range": `bytes ${start}-${start + part.length - 1}/${total}`,
            "Content-Length": part.length,
          })
          .end(part);
        return;
      }
      case "retry-after":
        response.writeHead(503, { "Retry-After": "1" }).end();
        return;
      case "ignore-range":
        response.writeHead(200, { "Content-Length": total }).end(Buffer.from(this.file));
        return;
      case "flip":
        body[body.length - 1]! ^= 1;
        break;
      case "gzip":
        response.setHeader("Content-Encoding", "br");
        break;
    }
    if (start > total - 1) {
      response.writeHead(416, { "Content-Range": `bytes */${total}` }).end();
      return;
    }
    const first = fault === "wrong-range" ? start + 1 : start;
    response.writeHead(206, { "Content-Range": `bytes ${first}-${end}/${total}`, "Content-Length": body.length });
    if (fault === "stall") {
      response.write(body.subarray(0, body.length >> 1));
      return;
    }
    if (fault === "cut") {
      response.write(body.subarray(0, body.length >> 1), () => response.destroy());
      return;
    }
    response.end(body);
  }
}
