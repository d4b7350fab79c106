import assert from "node:assert/strict";
import { test } from "node:test";
import { CogsplatError, SourceError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import { HttpSource, retryAfter } from "../src/loader/http_source.js";
import { nextRequest } from "../src/loader/range_plan.js";
import { DEFAULT_RETRY } from "../src/loader/retry.js";
import { RetryingReader } from "../src/loader/retrying_reader.js";
import { SegmentRequests } from "../src/loader/segment_requests.js";
import type { ChunkUpdate, StreamOptions } from "../src/loader/stream_options.js";
import { type OpenOptions, StreamedScene } from "../src/loader/streamed_scene.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { padSegments } from "./padded_file.js";
import { type Fault, RangeServer } from "./range_server.js";
import { manifest, sha256, vectorBytes } from "./vectors.js";

const FAST_RETRY = { retries: 3, pause: 1, longest: 4 };
const kernels = await loadKernels();

/** A file of four chunks, mostly after the first 64 KiB. */
const PADDED = padSegments(vectorBytes("valid", "chunks"), 200_000);

/** Serve a file, stream it whole, and give the last update of each chunk. */
async function streamFrom(
  file: Uint8Array,
  fault?: (number: number, range: readonly [number, number]) => Fault,
  options: StreamOptions = {},
  open: OpenOptions = {},
): Promise<{ last: Map<number, ChunkUpdate>; updates: ChunkUpdate[]; ranges: [number, number][] }> {
  const server = new RangeServer(file, fault);
  const url = await server.start();
  try {
    const scene = await StreamedScene.open(url, { retry: FAST_RETRY, ...open });
    const updates: ChunkUpdate[] = [];
    for await (const update of scene.stream(options)) updates.push(update);
    return { last: new Map(updates.map((update) => [update.chunk, update])), updates, ranges: server.ranges };
  } finally {
    await server.stop();
  }
}

function checkWhole(bytes: Uint8Array, last: ReadonlyMap<number, ChunkUpdate>): void {
  const file = new SceneFile(bytes, kernels());
  const all = Array.from({ length: file.index.chunkCount }, (_, chunk) => chunk);
  const drawn = all.filter((chunk) => file.index.isDrawn(chunk, all.length));
  assert.deepEqual([...last.keys()].sort(), drawn);
  let row = 0;
  for (const chunk of all) {
    if (!drawn.includes(chunk)) row += file.index.chunks.splats[chunk]!;
    if (!drawn.includes(chunk)) continue;
    const { splats, firstRow, count } = last.get(chunk)!;
    const expected = file.decodeChunk(chunk);
    assert.deepEqual([firstRow, count], [row, expected.count]);
    assert.equal(
      sha256(splats!.means, splats!.opacities, splats!.shN),
      sha256(expected.means, expected.opacities, expected.shN),
    );
    row += count;
  }
}

for (const { name, splats } of manifest.valid) {
  test(`${name} streams from a server and from a blob to the same rows`, async () => {
    const bytes = vectorBytes("valid", name);
    const { last } = await streamFrom(bytes);
    checkWhole(bytes, last);
    const scene = await StreamedScene.open(new Blob([new Uint8Array(bytes)]));
    const rows = new Map<number, number>();
    for await (const update of scene.stream()) rows.set(update.chunk, update.count);
    assert.equal(
      [...rows.values()].reduce((sum, count) => sum + count, 0),
      splats,
    );
  });
}

test("segments behind the first 64 KiB come by ranges, without the bytes between", async () => {
  const { last, ranges } = await streamFrom(PADDED);
  checkWhole(PADDED, last);
  assert.deepEqual(ranges[0], [0, 65_535]);
  const bytes = ranges.reduce((sum, [start, end]) => sum + end + 1 - start, 0);
  assert.ok(bytes < 120_000, `${bytes} bytes of ${PADDED.length}`);
});

for (const fault of ["status-500", "status-503", "cut", "shorter"] as const) {
  test(`a request that fails once with ${fault} is made again`, async () => {
    for (const failing of [0, 1]) {
      const { last, ranges } = await streamFrom(PADDED, (number) => (number === failing ? fault : undefined));
      checkWhole(PADDED, last);
      assert.ok(ranges.length > failing + 1);
    }
  });
}

for (const fault of ["hang", "stall"] as const) {
  test(`a server that says no more (${fault}) is asked again`, async () => {
    for (const failing of [0, 1]) {
      const silent = (number: number) => (number === failing ? fault : undefined);
      const { last, ranges } = await streamFrom(PADDED, silent, {}, { http: { longestPause: 100 } });
      checkWhole(PADDED, last);
      assert.ok(ranges.length > failing + 1);
    }
  });
}

test("a server that ignores ranges is read from the front", async () => {
  const { last } = await streamFrom(PADDED, () => "ignore-range");
  checkWhole(PADDED, last);
});

test("a segment that comes damaged is asked for again, alone", async () => {
  const { last, ranges } = await streamFrom(PADDED, (number) => (number === 1 ? "flip" : undefined));
  checkWhole(PADDED, last);
  assert.ok(ranges.length >= 3);
});

test("a tail that stays damaged is reported, and its chunk is given without it", async () => {
  const told: [string, number | undefined][] = [];
  const index = new SceneFile(PADDED, kernels()).index;
  const chunk = 0;
  const tail = index.range(index.chunkSegments(chunk).tail);
  const file = PADDED.slice();
  file[tail.offset]! ^= 1;
  const { last } = await streamFrom(file, undefined, {
    onDamage: (error, number) => told.push([error instanceof CogsplatError ? error.code : error.name, number]),
  });
  assert.deepEqual(told, [["segment-crc", chunk]]);
  assert.equal(last.size, index.chunkCount);
  assert.equal(last.get(chunk)!.tail, false);
});

test("damage ends the stream where nobody listens", async () => {
  const file = PADDED.slice();
  file[file.length - 1]! ^= 1;
  await assert.rejects(streamFrom(file), (error) => error instanceof CogsplatError && error.code === "segment-crc");
});

for (const [fault, isIt] of [
  ["wrong-range", (error: unknown) => error instanceof SourceError],
  ["gzip", (error: unknown) => error instanceof SourceError],
  ["other-etag", (error: unknown) => error instanceof CogsplatError && error.code === "source-changed"],
] as const) {
  test(`an answer with ${fault} is refused`, async () => {
    await assert.rejects(
      streamFrom(PADDED, (number) => (number > 0 ? fault : undefined)),
      isIt,
    );
  });
}

for (const fault of ["16-kib", "weak-etag"] as const) {
  test(`a server whose answers are all of ${fault} is read all the same`, async () => {
    const { last } = await streamFrom(PADDED, () => fault);
    checkWhole(PADDED, last);
  });
}

for (const [fault, isIt] of [
  ["status-403", (error: unknown) => error instanceof SourceError && error.status === 403],
  ["status-404", (error: unknown) => error instanceof SourceError && error.status === 404],
  ["status-416", (error: unknown) => error instanceof CogsplatError && error.code === "source-changed"],
] as const) {
  test(`${fault} in the middle ends the stream at once`, async () => {
    let asked = 0;
    await assert.rejects(
      streamFrom(PADDED, (number) => {
        asked++;
        return number > 0 ? fault : undefined;
      }),
      isIt,
    );
    assert.ok(asked <= 1 + 6, "no request is made again");
  });
}

test("retries end", async () => {
  await assert.rejects(
    streamFrom(PADDED, () => "status-503"),
    (error) => error instanceof SourceError && error.status === 503,
  );
});

test("an abort ends a stream that waits", async () => {
  const server = new RangeServer(PADDED, (number) => (number > 0 ? "hang" : undefined));
  const scene = await StreamedScene.open(await server.start());
  const abort = new AbortController();
  const stream = scene.stream({ signal: abort.signal });
  await assert.rejects(
    async () => {
      for (;;) {
        const next = stream.next();
        setTimeout(() => abort.abort(), 20);
        if ((await next).done) return;
      }
    },
    { name: "AbortError" },
  );
  await server.stop();
});

test("priorities order chunks and leave some out", async () => {
  // All of the file comes with the first request, so that chunks are given in the order in which they are wanted.
  const { updates } = await streamFrom(vectorBytes("valid", "chunks"), undefined, {
    priority: ({ chunk }) => (chunk === 1 ? -1 : chunk),
  });
  assert.deepEqual([...new Set(updates.map(({ chunk }) => chunk))], [3, 2, 0]);
});

test("a memory budget leaves the last chunks out", async () => {
  const { index } = new SceneFile(PADDED, kernels());
  const rows = index.chunks.splats[0]! + index.chunks.splats[1]!;
  const perSplat = 56 + 12 * ((index.scene.shDegree + 1) ** 2 - 1);
  const { last } = await streamFrom(PADDED, undefined, { memoryBudget: rows * perSplat });
  assert.deepEqual([...last.keys()].sort(), [0, 1]);
});

test("a budget of splats leaves the last chunks out", async () => {
  const { index } = new SceneFile(PADDED, kernels());
  const { last } = await streamFrom(PADDED, undefined, {
    splatBudget: index.chunks.splats[0]! + index.chunks.splats[1]!,
  });
  assert.deepEqual([...last.keys()].sort(), [0, 1]);
});

test("packed chunks have the words of every band", async () => {
  const { last } = await streamFrom(PADDED, undefined, { format: "packed", degree: 2 });
  for (const { packed, count } of last.values()) {
    assert.deepEqual(
      [packed!.words.length, ...packed!.sh.map((band) => band.length)],
      [4 * count, 2 * count, 4 * count],
    );
  }
});

test("compensation comes with the chunks and is taken back with the last", async () => {
  const bytes = vectorBytes("valid", "compensation");
  const file = new SceneFile(bytes, kernels());
  const scene = await StreamedScene.open(new Blob([new Uint8Array(bytes)]));
  const chunks = file.index.chunkCount;
  let prefix = 0;
  for await (const update of scene.stream({ compensate: true })) prefix = update.prefix;
  assert.equal(prefix, chunks);
  for (let n = 1; n <= chunks; n++) {
    for (let chunk = 0; chunk < n; chunk++) {
      const plain = file.decodeChunk(chunk);
      const expected = file.decodeChunk(chunk);
      file.compensate(expected, chunk, n);
      const shifts = scene.compensation.shifts(n, chunk);
      assert.equal(shifts === undefined, n === chunks);
      const added = plain.opacities.map((value, i) => value + (shifts?.opacities[i] ?? 0));
      if (shifts) assert.deepEqual(added, expected.opacities);
    }
  }
});

test("requests take neighbours together and stop at gaps, lengths and orders", () => {
  const ranges = [
    [0, 100],
    [100, 50],
    [70_000, 10],
    [140_000, 10],
    [150_000, 5_000_000],
    [5_150_000, 10],
  ] as const;
  const rangeOf = (segment: number) => ({ offset: ranges[segment]![0], length: ranges[segment]![1] });
  const take = (wanted: number[], most?: number) => nextRequest(wanted, rangeOf, most);
  const wanted = [0, 1, 2, 3, 4, 5];
  assert.deepEqual(take(wanted), { offset: 0, length: 150, segments: [0, 1] });
  assert.deepEqual(take(wanted), { offset: 70_000, length: 10, segments: [2] });
  assert.deepEqual(take(wanted), { offset: 140_000, length: 10, segments: [3] });
  assert.deepEqual(take(wanted), { offset: 150_000, length: 5_000_000, segments: [4] });
  assert.deepEqual(wanted, [5]);
  assert.deepEqual(take([1, 0]), { offset: 0, length: 150, segments: [0, 1] });
  assert.deepEqual(take([0, 1], 120), { offset: 0, length: 100, segments: [0] });
  assert.equal(take([]), undefined);
});

test("a request delivers its segments however the bytes are cut, without those of gaps", async () => {
  const bytes = Uint8Array.from({ length: 40 }, (_, i) => i);
  // The last two share their bytes, as segments of a folder may.
  const ranges = [
    { offset: 10, length: 8 },
    { offset: 20, length: 20 },
    { offset: 20, length: 20 },
  ];
  for (let size = 1; size <= 31; size++) {
    const reader = {
      readParts: async (_: unknown, __: unknown, take: (part: Uint8Array) => void) => {
        for (let at = 10; at < 40; at += size) take(bytes.subarray(at, Math.min(at + size, 40)));
      },
    } as unknown as RetryingReader;
    const received: [number, number[]][] = [];
    await new Promise<void>((ended) => {
      const requests = new SegmentRequests(reader, (segment) => ranges[segment]!, {
        received: (segment, payload) => received.push([segment, Array.from(payload)]),
        failed: () => assert.fail("nothing fails"),
        ended,
      });
      requests.start({ offset: 10, length: 30, segments: [0, 1, 2] });
    });
    const second = Array.from(bytes.subarray(20, 40));
    assert.deepEqual(received, [
      [0, Array.from(bytes.subarray(10, 18))],
      [1, second],
      [2, second],
    ]);
  }
});

test("requests over HTTP/2 and HTTP/3 share a connection, as far as the browser tells", (context) => {
  const expected = { h2: 24, h3: 24, "http/1.1": 6, "": 6 };
  for (const [protocol, most] of Object.entries(expected)) {
    const source = new HttpSource("http://localhost/scene.cogs");
    assert.equal(source.mostRequests, 6);
    const told = context.mock.method(performance, "getEntriesByName", (address: string, type: string) => {
      assert.deepEqual([address, type], ["http://localhost/scene.cogs", "resource"]);
      return [{ nextHopProtocol: "http/1.0" }, { nextHopProtocol: protocol }];
    });
    assert.equal(source.mostRequests, most);
    assert.equal(new RetryingReader(source, DEFAULT_RETRY).mostRequests, most);
    told.mock.restore();
    // What the first answers told stays, for entries are dropped.
    assert.equal(source.mostRequests, most);
  }
  assert.equal(new RetryingReader({ read: () => assert.fail("nothing is read") }, DEFAULT_RETRY).mostRequests, 6);
});

test("segments that share a part of their bytes come by requests of their own", () => {
  const ranges = [
    { offset: 0, length: 20 },
    { offset: 10, length: 20 },
  ];
  const wanted = [0, 1];
  assert.deepEqual(nextRequest(wanted, (segment) => ranges[segment]!)!.segments, [0]);
  assert.deepEqual(wanted, [1]);
});

/** A source whose first answer stops after some bytes until `goOn` is called. */
class SlowSource {
  readonly signals: (AbortSignal | undefined)[] = [];
  goOn: () => void = () => undefined;
  private readonly going = new Promise<void>((resolve) => (this.goOn = resolve));

  constructor(
    private readonly bytes: Uint8Array,
    private readonly stopAt: number,
  ) {}

  async read(
    { offset, length }: { offset: number; length: number },
    { signal }: { signal?: AbortSignal | undefined } = {},
  ) {
    const { bytes, stopAt, going } = this;
    const stops = this.signals.push(signal) === 1;
    const aborted = new Promise<void>((_, reject) => signal?.addEventListener("abort", () => reject(signal.reason)));
    aborted.catch(() => undefined);
    async function* parts(): AsyncGenerator<Uint8Array> {
      if (stops) {
        yield bytes.slice(offset, stopAt);
        await Promise.race([going, aborted]);
        yield bytes.slice(stopAt, offset + length);
      } else yield bytes.slice(offset, offset + length);
    }
    return { offset, total: bytes.length, whole: false, parts: parts() };
  }
}

/** A file of several chunks, and where its first chunk ends. */
function firstChunk(): { bytes: Uint8Array; end: number } {
  const bytes = vectorBytes("valid", "chunks");
  const { index } = new SceneFile(bytes, kernels());
  const { head } = index.chunkSegments(0);
  const { offset, length } = index.range(head);
  return { bytes, end: offset + length };
}

test("a chunk is given when its bytes are there, while the first request still comes", async () => {
  const { bytes, end } = firstChunk();
  const source = new SlowSource(bytes, end);
  const scene = await StreamedScene.open(source);
  const stream = scene.stream();
  const first = (await stream.next()).value!;
  assert.equal(first.chunk, 0);
  const last = new Map([[0, first]]);
  source.goOn();
  for await (const update of stream) last.set(update.chunk, update);
  checkWhole(bytes, last);
});

test("leaving a stream ends the first request, and the next stream asks for its rest", async () => {
  const { bytes, end } = firstChunk();
  const source = new SlowSource(bytes, end);
  const scene = await StreamedScene.open(source);
  const abort = new AbortController();
  await assert.rejects(
    async () => {
      for await (const _ of scene.stream({ signal: abort.signal })) abort.abort();
    },
    { name: "AbortError" },
  );
  assert.ok(source.signals[0]!.aborted);
  const last = new Map<number, ChunkUpdate>();
  for await (const update of scene.stream()) last.set(update.chunk, update);
  checkWhole(bytes, last);
});

test("a server that asks for a wait is not asked before, and not waited for too long", async () => {
  const start = performance.now();
  const { last } = await streamFrom(PADDED, (number) => (number === 1 ? "retry-after" : undefined));
  checkWhole(PADDED, last);
  // Timers have whole milliseconds, and may end slightly early.
  assert.ok(performance.now() - start >= 990);
  const retry = { ...FAST_RETRY, longestWait: 500 };
  await assert.rejects(
    streamFrom(PADDED, () => "retry-after", {}, { retry }),
    (error) => error instanceof SourceError && error.status === 503,
  );
});

test("waits are read as seconds or as a date by the server's clock", () => {
  assert.equal(retryAfter(null, null), undefined);
  assert.equal(retryAfter("120", null), 120_000);
  assert.equal(retryAfter("Fri, 31 Dec 1999 23:59:59 GMT", "Fri, 31 Dec 1999 23:59:29 GMT"), 30_000);
  assert.equal(retryAfter("Fri, 31 Dec 1999 23:59:59 GMT", null), 0);
  assert.equal(retryAfter("soon", null), undefined);
});

test("a source that changed is opened again once, around caches", async () => {
  const server = new RangeServer(PADDED, (number) => (number === 1 ? "other-etag" : undefined));
  const url = await server.start();
  const caches: (string | undefined)[] = [];
  const counted: typeof fetch = (input, init) => {
    caches.push(init?.cache);
    return fetch(input, init);
  };
  const drain = async (scene: StreamedScene): Promise<Map<number, ChunkUpdate>> => {
    const last = new Map<number, ChunkUpdate>();
    for await (const update of scene.stream()) last.set(update.chunk, update);
    return last;
  };
  try {
    const scene = await StreamedScene.open(url, { retry: FAST_RETRY, http: { fetch: counted } });
    await assert.rejects(drain(scene), (error) => error instanceof CogsplatError && error.code === "source-changed");
    const before = caches.length;
    const again = await scene.reopen();
    checkWhole(PADDED, await drain(again));
    assert.ok(caches.slice(0, before).every((cache) => cache === "default"));
    assert.ok(caches.slice(before).every((cache) => cache === "reload"));
    await assert.rejects(again.reopen(), (error) => error instanceof CogsplatError && error.code === "source-changed");
  } finally {
    await server.stop();
  }
});

test("a scene that takes more memory than is allowed is refused before it is fetched", async () => {
  const server = new RangeServer(PADDED);
  const url = await server.start();
  const refused = (error: unknown) => error instanceof CogsplatError && error.code === "decoded-size";
  try {
    const scene = await StreamedScene.open(url, { maxDecodedBytes: 1000 });
    const asked = server.ranges.length;
    await assert.rejects(scene.stream().next(), refused);
    assert.equal(server.ranges.length, asked);
    // A budget of the caller's own leaves chunks out instead.
    let rows = 0;
    for await (const { count } of scene.stream({ memoryBudget: 900 })) rows += count;
    assert.ok(rows < scene.info.splats);
  } finally {
    await server.stop();
  }
});

test("chunks that end are given where they are asked for, in time to be drawn", async () => {
  const bytes = vectorBytes("valid", "ends");
  const { updates } = await streamFrom(bytes, undefined, { ending: true });
  const { index } = new SceneFile(bytes, kernels());
  assert.deepEqual(new Set(updates.map(({ chunk }) => chunk)), new Set([0, 1, 2, 3]));
  assert.deepEqual(Array.from(index.chunks.until), [3, 4, 0, 0]);
  for (const { chunk, prefix } of updates.filter(
    (update, i) => updates.findIndex(({ chunk }) => chunk === update.chunk) === i,
  )) {
    assert.ok(index.isDrawn(chunk, prefix), `chunk ${chunk} of ${prefix}`);
  }
  assert.equal(updates.at(-1)!.prefix, 4);
});

test("a level comes with what it draws and nothing else", async () => {
  const bytes = padSegments(vectorBytes("valid", "levels"), 200_000);
  const file = new SceneFile(bytes, kernels());
  for (const [level, chunks] of [
    [0, [0, 1]],
    [1, [0, 2]],
    [2, [0, 2, 3, 4]],
  ] as const) {
    const { last, ranges } = await streamFrom(bytes, undefined, { level });
    assert.deepEqual([...last.keys()].sort(), chunks);
    for (const chunk of chunks) {
      const expected = file.decodeChunk(chunk, undefined, true, level);
      assert.equal(
        sha256(last.get(chunk)!.splats!.opacities),
        sha256(expected.opacities),
        `level ${level}, chunk ${chunk}`,
      );
    }
    const segments = chunks.flatMap((chunk) => {
      const { head, refinement, tail } = file.index.chunkSegments(chunk);
      return [head, refinement, tail, file.index.opacitiesAt(chunk, level) ?? -1].filter((segment) => segment >= 0);
    });
    const needed = segments.reduce((sum, segment) => sum + file.index.range(segment).length, 0);
    const fetched = ranges.slice(1).reduce((sum, [start, end]) => sum + end + 1 - start, 0);
    assert.ok(fetched <= needed, `level ${level}: ${fetched} bytes for ${needed}`);
  }
  await assert.rejects(streamFrom(bytes, undefined, { level: 3 }), RangeError);
});

test("requests beside each other go around the browser's cache, which lets one of an address begin at a time", async () => {
  const asked: (RequestCache | undefined)[] = [];
  const source = new HttpSource(new URL("http://localhost/scene.cogs"), {
    fetch: (_, init) => {
      asked.push(init?.cache);
      const headers = { "Content-Range": "bytes 0-3/100", "Content-Length": "4" };
      return Promise.resolve(new Response(new Uint8Array(4), { status: 206, headers }));
    },
  });
  for (const options of [{}, { priority: "low" }, { fresh: true }] as const)
    await source.read({ offset: 0, length: 4 }, options);
  // An object of a folder has an address of its own.
  await source.relative("segments/a").read({ offset: 0, length: 4 }, { priority: "low" });
  assert.deepEqual(asked, ["default", "no-store", "reload", "default"]);
});
