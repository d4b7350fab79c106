import assert from "node:assert/strict";
import { test } from "node:test";
import { Worker } from "node:worker_threads";
import { CogsplatError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { DecoderPool } from "../src/workers/decoder_pool.js";
import type { Response } from "../src/workers/messages.js";
import { findRunningWay, type WorkerLike } from "../src/workers/worker_start.js";
import { sha256, vectorBytes } from "./vectors.js";

const kernels = await loadKernels();

/** A thread of Node with the messages of a browser's worker. */
function nodeWorker(): WorkerLike {
  const program = new URL("../src/workers/worker.js", import.meta.url).href;
  const bridge = `
    import { parentPort } from "node:worker_threads";
    globalThis.postMessage = (message, transfer) => parentPort.postMessage(message, transfer);
    await import(${JSON.stringify(program)});
    parentPort.on("message", (data) => globalThis.onmessage({ data }));
  `;
  const thread = new Worker(new URL(`data:text/javascript,${encodeURIComponent(bridge)}`));
  const worker: WorkerLike = {
    onmessage: null,
    onerror: null,
    postMessage: (message) => thread.postMessage(message),
    terminate: () => void thread.terminate(),
  };
  thread.on("message", (data: Response) => worker.onmessage?.({ data } as MessageEvent<Response>));
  thread.on("error", (error: Error) => worker.onerror?.({ message: error.message } as ErrorEvent));
  return worker;
}

for (const name of ["transform", "two-books", "chunks", "pages"]) {
  test(`workers decode ${name} to the bits that one thread gives`, async () => {
    const bytes = vectorBytes("valid", name);
    const file = new SceneFile(bytes, kernels());
    const scene = await StreamedScene.open(new Blob([new Uint8Array(bytes)]), {
      service: (index) => new DecoderPool(index, { workers: 2, makeWorker: nodeWorker }),
    });
    const last = new Map<number, string>();
    for await (const { chunk, splats } of scene.stream())
      last.set(chunk, sha256(splats!.means, splats!.quats, splats!.shN));
    assert.equal(last.size, file.index.chunkCount);
    for (const [chunk, hash] of last) {
      const expected = file.decodeChunk(chunk);
      assert.equal(hash, sha256(expected.means, expected.quats, expected.shN), `chunk ${chunk}`);
    }
  });
}

test("a worker's refusal keeps its reason code", async () => {
  const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("invalid", "code-past"))]), {
    service: (index) => new DecoderPool(index, { workers: 1, makeWorker: nodeWorker }),
  });
  await assert.rejects(
    async () => {
      for await (const _update of scene.stream());
    },
    (error) => error instanceof CogsplatError && error.code === "code-range",
  );
});

/** A worker that starts and then answers every chunk by an event, or one that cannot be started. */
function brokenWorker(event: "onerror" | "onmessageerror", starts: boolean, message?: string): WorkerLike {
  const report = { message } as ErrorEvent & MessageEvent;
  const worker: WorkerLike = {
    onmessage: null,
    onerror: null,
    onmessageerror: null,
    postMessage: ({ type }) => {
      if (type === "chunk") queueMicrotask(() => worker[event]?.(report));
    },
    terminate: () => undefined,
  };
  queueMicrotask(() => {
    if (starts) worker.onmessage?.({ data: { ready: true } } as MessageEvent<Response>);
    else worker.onerror?.(report);
  });
  return worker;
}

async function streamWith(makeWorker: (() => WorkerLike) | undefined): Promise<number> {
  const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("valid", "two-books"))]), {
    service: (index) => new DecoderPool(index, { workers: 1, ...(makeWorker && { makeWorker }) }),
  });
  let splats = 0;
  for await (const update of scene.stream()) splats += update.splats!.count;
  return splats;
}

for (const event of ["onerror", "onmessageerror"] as const) {
  test(`a worker that ends in ${event} ends the stream`, async () => {
    await assert.rejects(
      streamWith(() => brokenWorker(event, true, "out of memory")),
      /a worker failed \(the option makeWorker\): (out of memory|an unreadable message)/,
    );
  });
}

test("a worker that fails without a reason is described without one", async () => {
  await assert.rejects(
    streamWith(() => brokenWorker("onerror", true)),
    (error: Error) => /worker-src/.test(error.message) && !/undefined/.test(error.message),
  );
});

const unstartable = {
  "fails by an event": () => brokenWorker("onerror", false),
  "fails by an exception": () => {
    throw new Error("refused");
  },
  "does not exist": undefined,
};
for (const [how, makeWorker] of Object.entries(unstartable)) {
  test(`chunks are decoded here, with a message, where a worker ${how}`, async ({ mock }) => {
    const warn = mock.method(console, "warn", () => undefined);
    const expected = new SceneFile(vectorBytes("valid", "two-books"), kernels()).index.chunks.splats;
    assert.equal(
      await streamWith(makeWorker),
      expected.reduce((sum, count) => sum + count, 0),
    );
    assert.equal(warn.mock.callCount(), 1);
    const [message] = warn.mock.calls[0]!.arguments as [string];
    assert.match(message, makeWorker ? /the option makeWorker\): \w/ : /this environment has none/);
    assert.doesNotMatch(message, /undefined/);
  });
}

test("the next way is tried where one fails, and its worker is the one that decodes", async ({ mock }) => {
  const warn = mock.method(console, "warn", () => undefined);
  const ways = [
    { address: "a", start: () => brokenWorker("onerror", false) },
    { address: "b", start: nodeWorker },
  ];
  const running = await findRunningWay(ways, new AbortController().signal);
  assert.equal(running?.way.address, "b");
  assert.equal(warn.mock.callCount(), 0);
  running?.first?.terminate();
});
