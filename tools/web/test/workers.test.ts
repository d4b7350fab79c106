import assert from "node:assert/strict";
import { test } from "node:test";
import { Worker } from "node:worker_threads";
import { CogsplatError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { DecoderPool, type WorkerLike } from "../src/workers/decoder_pool.js";
import type { Response } from "../src/workers/messages.js";
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

for (const event of ["onerror", "onmessageerror"] as const) {
  test(`a worker that ends in ${event} ends the stream`, async () => {
    const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("valid", "chunks"))]), {
      service: (index) =>
        new DecoderPool(index, {
          workers: 1,
          makeWorker: () => {
            const worker: WorkerLike = {
              onmessage: null,
              onerror: null,
              onmessageerror: null,
              postMessage: ({ type }) => {
                const message = { message: "out of memory" } as ErrorEvent & MessageEvent;
                if (type === "chunk") queueMicrotask(() => worker[event]?.(message));
              },
              terminate: () => undefined,
            };
            return worker;
          },
        }),
    });
    await assert.rejects(async () => {
      for await (const _update of scene.stream());
    }, /worker/);
  });
}
