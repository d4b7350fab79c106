import { createServer, type IncomingMessage, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";

/** A server of a folder: answers ranges or, where it knows none, sends every file whole. */
export class FolderServer {
  /** Paths below the folder that were asked for, in order. */
  readonly asked: string[] = [];
  private readonly server = createServer((request, response) => this.answer(request, response));

  constructor(
    private readonly files: ReadonlyMap<string, Uint8Array>,
    private readonly options: {
      readonly ranges?: boolean;
      /** Changes the body of an answer, by its number from 0 on and its path. */
      readonly damage?: (body: Buffer, number: number, path: string) => void;
    } = {},
  ) {}

  /** Listen on a free port; gives the URL of the folder. */
  async start(): Promise<string> {
    await new Promise<void>((resolve) => this.server.listen(0, "127.0.0.1", resolve));
    return `http://127.0.0.1:${(this.server.address() as AddressInfo).port}/scene/`;
  }

  async stop(): Promise<void> {
    this.server.closeAllConnections();
    await new Promise((resolve) => this.server.close(resolve));
  }

  private answer(request: IncomingMessage, response: ServerResponse): void {
    const path = new URL(request.url!, "http://server").pathname.replace("/scene/", "");
    const number = this.asked.push(path) - 1;
    const file = this.files.get(path);
    if (file === undefined) {
      response.writeHead(404).end();
      return;
    }
    const asked = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
    const start = Number(asked?.[1] ?? 0);
    const end = Math.min(Number(asked?.[2] ?? Infinity), file.length - 1);
    const isWhole = this.options.ranges === false || file.length === 0;
    const body = Buffer.from(isWhole ? file : file.slice(start, end + 1));
    this.options.damage?.(body, number, path);
    const headers = isWhole ? {} : { "Content-Range": `bytes ${start}-${end}/${file.length}` };
    response.writeHead(isWhole ? 200 : 206, { ...headers, "Content-Length": body.length }).end(body);
  }
}
