import assert from "node:assert/strict";
import { test } from "node:test";
import { loadKernels } from "../src/kernels/load.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import type { PackedSplats } from "../src/scene/packed_splats.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { EndingChunks } from "../src/viewer/ending_chunks.js";
import { LevelOpacities } from "../src/viewer/level_opacities.js";
import { levelForSize, levelOfPrefix } from "../src/viewer/levels.js";
import { vectorBytes } from "./vectors.js";

const kernels = await loadKernels();
const LEVELS = [
  { chunks: 2, scale: 8 },
  { chunks: 4, scale: 4 },
  { chunks: 8, scale: 1 },
];

test("the level of a size lies where its width lies between those of two levels (SPEC 8.11)", () => {
  const sizes = [0.01, 0.125, 0.1875, 0.25, 0.4375, 1, 7];
  assert.deepEqual(
    sizes.map((size) => levelForSize(LEVELS, size)),
    [0, 0, 0.5, 1, 1.25, 2, 2],
  );
  assert.equal(levelForSize(LEVELS.slice(0, 1), 0.5), 0);
});

test("a prefix has come as far as the chunks of the next level that are there", () => {
  assert.deepEqual(
    [0, 1, 2, 3, 4, 5, 8].map((chunks) => levelOfPrefix(LEVELS, chunks)),
    [0, 0, 0, 0.5, 1, 1.25, 2],
  );
});

test("words hold the opacities at two adjacent levels, 0 where a level does not draw the chunk", () => {
  const opacities = new LevelOpacities();
  opacities.put(3, [1, 2], [Uint8Array.of(10, 20), Uint8Array.of(200, 100)]);
  opacities.put(4, [0, 1, 2], [Uint8Array.of(50), undefined, Uint8Array.of(70)]);
  opacities.put(5, [], [Uint8Array.of(90)]);
  assert.deepEqual([...opacities.known], [3, 4, 5]);
  assert.deepEqual(
    [0, 1, 2].map((level) => Array.from(opacities.words(3, level))),
    [
      [10 << 8, 20 << 8],
      [10 | (200 << 8), 20 | (100 << 8)],
      [200, 100],
    ],
  );
  // What has not come is that of the level before.
  assert.deepEqual(
    [0, 1].map((level) => opacities.words(4, level)[0]),
    [50 | (50 << 8), 50 | (70 << 8)],
  );
  // A chunk that no level draws is there for the first seconds.
  assert.equal(opacities.words(5, 1)[0], 90 | (90 << 8));
  assert.equal(opacities.words(5, 1, 0.5)[0], 45 | (45 << 8));
});

for (const name of ["levels", "levels-pages", "levels-kept"]) {
  test(`${name}: packed chunks have their opacities at every level`, async () => {
    const bytes = vectorBytes("valid", name);
    const file = new SceneFile(bytes, kernels());
    const scene = await StreamedScene.open(new Blob([new Uint8Array(bytes)]));
    const last = new Map<number, PackedSplats>();
    for await (const { chunk, packed } of scene.stream({ format: "packed", ending: true })) last.set(chunk, packed!);
    let checked = 0;
    for (const [chunk, packed] of last) {
      const opacities = new LevelOpacities();
      const drawnBy = file.index.levelsOf(chunk);
      opacities.put(chunk, drawnBy, packed.opacities!);
      for (let level = 0; level < scene.info.levels.length; level++) {
        const words = opacities.words(chunk, level);
        if (!drawnBy.includes(level)) {
          assert.ok(words.every((word) => (word & 255) === 0));
          continue;
        }
        const logits = file.decodeChunk(chunk, 0, true, level).opacities;
        logits.forEach((logit, row) => {
          assert.equal(words[row]! & 255, Math.round(255 / (1 + Math.exp(-logit))));
        });
        checked += logits.length;
      }
    }
    assert.ok(checked > 0);
  });
}

test("chunks that have ended fade within half a second, or go at once", () => {
  const painted: string[] = [];
  const ending = new EndingChunks(
    (_chunk, prefix) => prefix < 5,
    (chunk, factor) => painted.push(`${chunk}: ${factor.toFixed(2)}`),
  );
  const taken = () => painted.splice(0);
  ending.put(0, 1);
  ending.show(4, 1000);
  assert.ok(!ending.work(1000));
  assert.deepEqual(taken(), []);
  ending.show(5, 1000);
  assert.ok(ending.work(1100));
  // More of a chunk that fades takes nothing back.
  ending.put(0, 5);
  ending.show(6, 1200);
  assert.ok(ending.work(1300));
  assert.ok(!ending.work(1500));
  assert.ok(!ending.work(1600));
  assert.deepEqual(taken(), ["0: 0.75", "0: 0.25", "0: 0.00"]);
  // What comes after its end is not shown, nor is more of what has gone.
  ending.put(0, 6);
  ending.put(1, 6);
  assert.deepEqual(taken(), ["0: 0.00", "1: 0.00"]);
  // Prefixes that a person looks at show what they draw.
  ending.show(3, undefined);
  assert.deepEqual(taken(), ["0: 1.00", "1: 1.00"]);
  ending.show(5, 2000);
  ending.work(2100);
  taken();
  ending.show(5, undefined);
  assert.deepEqual(taken(), ["0: 0.00", "1: 0.00"]);
  assert.ok(!ending.work(2200));
});
