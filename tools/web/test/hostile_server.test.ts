import assert from "node:assert/strict";
import { getEventListeners } from "node:events";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { CogsplatError, SourceError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import { BlobSource, type ByteSource, GrowingBytes } from "../src/loader/byte_source.js";
import { HttpSource } from "../src/loader/http_source.js";
import { LinkEstimate } from "../src/loader/link_estimate.js";
import { RetryingReader } from "../src/loader/retrying_reader.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { Visit } from "../src/loader/visit.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { type Case, makeCase, runCase } from "./loader_cases.js";
import { padSegments } from "./padded_file.js";
import { type Fault, ScriptedServer } from "./scripted_server.js";
import { vectorBytes } from "./vectors.js";

const kernels = await loadKernels();
const RETRY = { retries: 3, pause: 1, longest: 2, longestWait: 20 };
const URL_OF_SCENE = "http://scripted.invalid/scene.cogs";
const PADDED = padSegments(vectorBytes("valid", "chunks"), 100_000);
/** Mutations of a hostile server; CI makes more of them, and `scripts/fuzz_loader.mjs` any number. */
const CASES = Number(process.env.COGSPLAT_FUZZ ?? 60);

/** Open and stream a scene from a server all of whose answers have a fault. */
async function streamFrom(server: ScriptedServer, longestPause = 1000): Promise<number> {
  const scene = await StreamedScene.open(URL_OF_SCENE, { http: { ...server.http, longestPause }, retry: RETRY });
  let updates = 0;
  for await (const _ of scene.stream()) updates++;
  return updates;
}

const always = (fault: Fault) => new ScriptedServer(PADDED, () => fault);

for (const [what, fault] of [
  ["one byte an answer", { most: 1 }],
  ["one byte a connection", { end: 1, ending: "error" }],
  ["a hundred bytes a connection", { end: 100, ending: "error" }],
] as const) {
  test(`a server of ${what} is left after five attempts without progress`, async () => {
    const server = always(fault);
    await assert.rejects(streamFrom(server), SourceError);
    assert.equal(server.ranges.length, 1 + RETRY.retries);
    assert.equal(server.open, 0);
  });
}

for (const pause of [10, 1]) {
  test(`a byte every ${pause} ms is no progress`, async () => {
    const server = always({ part: 1, pause });
    await assert.rejects(streamFrom(server, 100), /bytes in 100 ms, expected 16384/);
    assert.equal(server.ranges.length, 1 + RETRY.retries);
    assert.ok(server.bytes <= 4 * 100, `${server.bytes} bytes`);
    assert.equal(server.open, 0);
  });
}

test("an answer may take any time in parts that are progress, and while its reader pauses", async () => {
  const server = new ScriptedServer(PADDED, () => ({ part: 16_384, pause: 30 }));
  const source = new HttpSource(URL_OF_SCENE, { ...server.http, longestPause: 1000 });
  const { parts } = await source.read({ offset: 0, length: 65_536 });
  let bytes = 0;
  for await (const part of parts) {
    bytes += part.length;
    // Longer in sum than the longest pause.
    await new Promise((resolve) => setTimeout(resolve, 400));
  }
  assert.equal(bytes, 65_536);
});

for (const ranges of [true, false]) {
  test(`a body without end is taken as far as the file goes, ${ranges ? "with" : "without"} ranges`, async () => {
    const headers = { "Content-Length": null };
    const server = always({ behind: -1, headers, ...(!ranges && { whole: true }) });
    assert.ok((await streamFrom(server)) > 0);
    assert.ok(server.bytes < 3 * PADDED.length, `${server.bytes} bytes`);
    assert.equal(server.open, 0);
  });
}

test("a body of zeros without end is refused by its first bytes", async () => {
  const server = new ScriptedServer(new Uint8Array(64), () => ({
    behind: -1,
    whole: true,
    headers: { "Content-Length": null },
  }));
  await assert.rejects(streamFrom(server), (error) => error instanceof CogsplatError && error.code === "not-cogs");
  assert.ok(server.bytes <= 2 * 65_536, `${server.bytes} bytes`);
  await new Promise((resolve) => setTimeout(resolve, 5));
  assert.equal(server.open, 0);
});

for (const client of ["stream", "visit"] as const) {
  test(`a ${client} that ends stops the first request, whose other bytes it does not need`, async () => {
    // Behind the root and the first head, the first answer has a segment to be skipped.
    const server = new ScriptedServer(PADDED, (number) =>
      number === 0 ? { end: 30_000, ending: "stall" } : undefined,
    );
    const scene = await StreamedScene.open(URL_OF_SCENE, { http: server.http, retry: RETRY });
    const changes = client === "stream" ? scene.stream() : (await Visit.begin(scene)).changes();
    for await (const _ of changes) assert.equal(server.open > 0, true);
    await new Promise((resolve) => setTimeout(resolve, 5));
    assert.equal(server.open, 0);
  });
}

test("reads leave no listener at the signal of their caller", async () => {
  const abort = new AbortController();
  const faults: Fault[] = [{}, { status: 404 }, { end: 9, ending: "error" }, { instead: "TypeError" }, { end: 9 }];
  const server = new ScriptedServer(PADDED, (number) => faults[number % faults.length]);
  const source = new HttpSource(URL_OF_SCENE, server.http);
  for (let number = 0; number < 100; number++) {
    const work = async (): Promise<void> => {
      const { parts } = await source.read({ offset: 0, length: 20_000 }, { signal: abort.signal });
      // Every other caller leaves before the end.
      for await (const _ of parts) if (number % 2 === 0) break;
    };
    await work().catch((error: unknown) => assert.ok(error instanceof SourceError, String(error)));
  }
  assert.equal(getEventListeners(abort.signal, "abort").length, 0);
  assert.equal(server.open, 0);
});

test("a read that is aborted ends with the reason of its caller", async () => {
  for (const fault of [{ instead: "nothing" }, { end: 9, ending: "stall" }] as const) {
    const abort = new AbortController();
    const reader = new RetryingReader(new HttpSource(URL_OF_SCENE, always(fault).http), RETRY);
    const reading = reader.readAll({ offset: 0, length: 20_000 }, abort.signal);
    const reason = new Error("enough");
    setTimeout(() => abort.abort(reason), 5);
    await assert.rejects(reading, reason);
    assert.equal(getEventListeners(abort.signal, "abort").length, 0);
  }
});

test("a body cut short is an error of the source", async () => {
  const source = new HttpSource(URL_OF_SCENE, always({ end: 9, ending: "error" }).http);
  const { parts } = await source.read({ offset: 0, length: 100 });
  await assert.rejects(
    async () => {
      for await (const _ of parts);
    },
    (error) => error instanceof SourceError && error.retryable && /terminated/.test(error.message),
  );
});

for (const thrown of [new RangeError("a range"), "a text", undefined, new DOMException("gone", "NotReadableError")]) {
  test(`a source that throws ${String(thrown)} ends a stream with an error of the source`, async () => {
    const source: ByteSource = {
      read: async () => {
        throw thrown;
      },
    };
    await assert.rejects(StreamedScene.open(source), SourceError);
    const late = new BlobSource(new Blob([PADDED.slice()]));
    let reads = 0;
    const breaks: ByteSource = {
      read: async (range, options) => {
        if (reads++ > 0) throw thrown;
        return late.read(range, options);
      },
    };
    const scene = await StreamedScene.open(breaks, { retry: RETRY });
    await assert.rejects(async () => {
      for await (const _ of scene.stream());
    }, SourceError);
  });
}

test("a server that fails for good ends a stream that reports damage", async () => {
  const { segments } = new SceneFile(vectorBytes("valid", "chunks"), kernels()).index;
  // Every segment takes a request of its own.
  let file = vectorBytes("valid", "chunks");
  for (let segment = segments.kind.length - 1; segment >= 0; segment--) file = padSegments(file, 70_000, segment);
  const server = new ScriptedServer(file, (number) => (number === 0 ? undefined : { status: 503 }));
  const scene = await StreamedScene.open(URL_OF_SCENE, { http: server.http, retry: RETRY });
  const lost: unknown[] = [];
  await assert.rejects(
    async () => {
      for await (const _ of scene.stream({ onDamage: (error) => lost.push(error) }));
    },
    (error) => error instanceof SourceError && error.status === 503,
  );
  assert.ok(lost.length > 0 && lost.length < segments.kind.length, `${lost.length} segments`);
});

test("an error of the caller's own function ends the stream", async () => {
  const file = PADDED.slice();
  file[file.length - 1]! ^= 1;
  const scene = await StreamedScene.open(new Blob([file]), { retry: RETRY });
  const own = new Error("of the caller");
  const onDamage = (): void => {
    throw own;
  };
  await assert.rejects(async () => {
    for await (const _ of scene.stream({ onDamage }));
  }, own);
});

test("memory grows with the bytes received, not with the length stated", () => {
  const bytes = new GrowingBytes(2 ** 40);
  for (let part = 0; part < 100; part++) bytes.push(new Uint8Array(100).fill(part));
  assert.equal(bytes.length, 10_000);
  assert.ok(bytes.take().buffer.byteLength <= 32_768);
  assert.ok(bytes.take().every((value, at) => value === Math.floor(at / 100)));
});

test("a connection of single bytes is measured in little memory", () => {
  const link = new LinkEstimate();
  for (let byte = 0; byte < 100_000; byte++) link.recordBytes(1, byte / 100_000);
  assert.ok(Math.abs(link.bytesPerSecond - 100_000) < 2000, `${link.bytesPerSecond}`);
});

const kept = JSON.parse(readFileSync(join(process.cwd(), "test", "loader_cases.json"), "utf8")) as readonly {
  readonly name: string;
  readonly seed: number;
  /** How the case ends. */
  readonly end: string;
  readonly case: Case;
}[];

for (const { name, seed, end, case: given } of kept) {
  test(`finding stays mended: ${name}`, async () => {
    assert.equal((await runCase(given, seed)).end, end);
  });
}

test("whatever a server does, the loader gives right rows or its own errors, in bounded time and requests", async () => {
  const ends = new Set<string>();
  for (let seed = 1; seed <= CASES; seed++) {
    try {
      ends.add((await runCase(makeCase(seed), seed)).end);
    } catch (error) {
      assert.fail(`seed ${seed}: ${String(error)}; ${JSON.stringify(makeCase(seed))}`);
    }
  }
  assert.ok(ends.has("complete") && ends.has("settled") && ends.size > 4, [...ends].join());
});

test("a case follows from its seed", () => {
  assert.deepEqual(makeCase(5), makeCase(5));
  assert.notDeepEqual(makeCase(5), makeCase(6));
});
