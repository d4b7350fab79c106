import assert from "node:assert/strict";
import { test } from "node:test";
import { loadKernels } from "../src/kernels/load.js";
import { ChunkQueue } from "../src/loader/chunk_queue.js";
import { KeptHeads } from "../src/loader/kept_heads.js";
import type { ChunkUpdate } from "../src/loader/stream_options.js";
import { DEFAULT_RANGES } from "../src/scene/packed_splats.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { type ChunkFormat, type DecodedChunk, type DecodeTask, InlineService } from "../src/workers/decode_task.js";
import { buffersOf } from "../src/workers/messages.js";
import { manifest, sha256, vectorBytes } from "./vectors.js";

const kernels = await loadKernels();
const FORMATS: readonly ChunkFormat[] = ["splats", "packed"];
const PLENTY = 2 ** 30;

/** A service that notes its tasks. */
class NotingService extends InlineService {
  readonly tasks: DecodeTask[] = [];

  override decodeNow(task: DecodeTask): DecodedChunk {
    this.tasks.push(task);
    return super.decodeNow(task);
  }
}

/** A queue for all chunks of a file, with what it gave and asked for. */
function queueOf(bytes: Uint8Array, format: ChunkFormat, most: number, degree?: number) {
  const { index } = new SceneFile(bytes, kernels());
  const service = new NotingService(index, kernels);
  const updates: Omit<ChunkUpdate, "prefix">[] = [];
  const queue = new ChunkQueue(
    index,
    service,
    { degree: degree ?? index.scene.shDegree, format, ranges: DEFAULT_RANGES, refine: true },
    (update) => updates.push(update),
    (error) => assert.fail(String(error)),
  );
  queue.keepAtMost(most);
  const chunks = Array.from({ length: index.chunkCount }, (_, chunk) => chunk);
  for (const chunk of chunks) queue.expect(chunk);
  /** Hand over segments, codebooks first, and wait until what they allow is decoded. */
  const add = async (segments: readonly number[]): Promise<void> => {
    for (const segment of segments) {
      const { offset, length } = index.range(segment);
      if (length > 0 && !queue.has(segment)) queue.add(segment, bytes.slice(offset, offset + length));
    }
    do await new Promise((resolve) => setImmediate(resolve));
    while (!queue.idle);
  };
  const parts = chunks.map((chunk) => index.chunkSegments(chunk));
  const of = (part: "head" | "refinement" | "tail") =>
    parts.map((segments) => segments[part]).filter((segment) => segment >= 0);
  return { queue, service, updates, add, of, codebooks: index.allCodebookSegments() };
}

/** Hash of all arrays of a chunk. */
function hashOf(chunk: DecodedChunk): string {
  return sha256(...buffersOf(chunk).map((buffer) => new Uint8Array(buffer)));
}

/** The last update of every chunk. */
function lastOf(updates: readonly Omit<ChunkUpdate, "prefix">[]): Map<number, string> {
  return new Map(updates.map((update) => [update.chunk, hashOf(update)]));
}

for (const format of FORMATS) {
  test(`tails that come later are decoded alone into ${format}, to the same bits`, async () => {
    let alone = 0;
    for (const { name } of manifest.valid) {
      const bytes = vectorBytes("valid", name);
      const atOnce = queueOf(bytes, format, 0);
      await atOnce.add([...atOnce.codebooks, ...atOnce.of("tail"), ...atOnce.of("refinement"), ...atOnce.of("head")]);
      const later = queueOf(bytes, format, PLENTY);
      await later.add([...later.codebooks, ...later.of("head")]);
      await later.add(later.of("refinement"));
      const before = later.service.tasks.length;
      await later.add(later.of("tail"));
      assert.deepEqual(lastOf(later.updates), lastOf(atOnce.updates), name);
      const tailTasks = later.service.tasks.slice(before);
      assert.ok(
        tailTasks.every(({ payloads }) => payloads.head === undefined),
        name,
      );
      alone += tailTasks.length;
      assert.equal(later.queue.keptBytes, 0, name);
    }
    assert.ok(alone > 0);
  });
}

test("heads that there is no room for are decoded again, to the same bits", async () => {
  const bytes = vectorBytes("valid", "chunks");
  const kept = queueOf(bytes, "packed", PLENTY);
  const none = queueOf(bytes, "packed", 0);
  for (const { add, codebooks, of } of [kept, none]) {
    await add([...codebooks, ...of("head"), ...of("refinement")]);
    await add(of("tail"));
  }
  assert.deepEqual(lastOf(none.updates), lastOf(kept.updates));
  assert.ok(none.service.tasks.every(({ payloads }) => payloads.head !== undefined));
  assert.ok(kept.service.tasks.some(({ payloads }) => payloads.head === undefined));
});

test("a refinement behind the tail decodes the whole chunk", async () => {
  const { name } = manifest.valid.find(({ coarse_sha256 }) => coarse_sha256 !== undefined)!;
  const bytes = vectorBytes("valid", name);
  const atOnce = queueOf(bytes, "splats", 0);
  await atOnce.add([...atOnce.codebooks, ...atOnce.of("tail"), ...atOnce.of("refinement"), ...atOnce.of("head")]);
  const later = queueOf(bytes, "splats", PLENTY);
  for (const part of ["head", "tail", "refinement"] as const) await later.add([...later.codebooks, ...later.of(part)]);
  assert.deepEqual(lastOf(later.updates), lastOf(atOnce.updates));
  assert.equal(later.queue.keptBytes, 0);
});

test("nothing is kept where no bands are wanted or the tail cannot be had", async () => {
  const bytes = vectorBytes("valid", "chunks");
  const plain = queueOf(bytes, "packed", PLENTY, 0);
  await plain.add([...plain.codebooks, ...plain.of("head")]);
  assert.equal(plain.queue.keptBytes, 0);
  const lost = queueOf(bytes, "packed", PLENTY);
  await lost.add([...lost.codebooks, ...lost.of("head"), ...lost.of("refinement")]);
  assert.ok(lost.queue.keptBytes > 0);
  for (const tail of lost.of("tail")) lost.queue.abandon(tail);
  assert.equal(lost.queue.keptBytes, 0);
});

test("what callers do with the rows that they are given does not reach what is kept", async () => {
  const bytes = vectorBytes("valid", "chunks");
  const changed = queueOf(bytes, "packed", PLENTY);
  const untouched = queueOf(bytes, "packed", PLENTY);
  for (const { add, codebooks, of, updates } of [changed, untouched]) {
    await add([...codebooks, ...of("head"), ...of("refinement")]);
    if (updates === changed.updates) for (const { packed } of updates) packed!.words.fill(7);
    await add(of("tail"));
  }
  assert.deepEqual(lastOf(changed.updates), lastOf(untouched.updates));
});

test("kept heads stay within their limit, and those that came last go first", () => {
  const heads = new KeptHeads();
  const packed = (splats: number): DecodedChunk => ({
    packed: {
      count: splats,
      words: new Uint32Array(4 * splats),
      means: new Float32Array(3 * splats),
      sh: [],
      ranges: DEFAULT_RANGES,
    },
  });
  heads.keepAtMost(28 * 100);
  heads.keep(0, packed(60));
  heads.keep(1, packed(60));
  assert.equal(heads.bytes, 28 * 60);
  heads.keep(2, packed(40));
  assert.equal(heads.bytes, 28 * 100);
  heads.keepAtMost(28 * 70);
  assert.equal(heads.bytes, 28 * 60);
  assert.equal(heads.remove(2), undefined);
  assert.equal(heads.remove(0)!.packed!.words.length, 4 * 60);
  assert.equal(heads.bytes, 0);
});
