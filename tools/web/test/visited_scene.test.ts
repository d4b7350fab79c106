import assert from "node:assert/strict";
import { test } from "node:test";
import type { Index } from "../src/container/scene_index.js";
import { SceneRows } from "../src/container/scene_rows.js";
import type { PackedSplats } from "../src/scene/packed_splats.js";
import { VisitedScene } from "../src/viewer/visited_scene.js";

type Scene = ConstructorParameters<typeof VisitedScene>[0];
type Layer = ConstructorParameters<typeof VisitedScene>[1];

/** Splats of each chunk: two cells of the second depth, the first of which has two more below it, the other one. */
const SPLATS = [10, 10, 30, 10, 10, 10];
const CELLS = [1, 2, 3, 4, 5, 6];

/** Splats whose words say whose they are: the chunk, then the row of the chunk. */
function packedOf(chunk: number): PackedSplats {
  const words = Uint32Array.from({ length: 4 * SPLATS[chunk]! }, (_, i) => 1000 * (chunk + 1) + Math.floor(i / 4));
  return { words, count: SPLATS[chunk]!, sh: [] } as unknown as PackedSplats;
}

/** Boxes along x: all, its halves, the halves of the first half, and one within the second half. */
const ENDS = [0, 8, 0, 4, 4, 8, 0, 2, 2, 4, 4, 6];

/** Fakes of a scene and a layer that record calls and rows. */
function watched(capacity: number, ratios: () => Float64Array | undefined, layerChunks = 6) {
  const prefixes = new Map<number, number>();
  const rows = new Array<number>(capacity).fill(0);
  const shifts = new Array<number>(capacity).fill(0);
  const sceneRows = new SceneRows();
  const boxes = Float32Array.from(CELLS.flatMap((_, i) => [ENDS[2 * i]!, 0, 0, ENDS[2 * i + 1]!, 1, 1]));
  const root = { firstChunk: 0, chunkCount: 6, firstRow: 0, pages: [], boxes } as unknown as Index;
  sceneRows.enter(root, { splats: Uint32Array.from(SPLATS), cell: Uint32Array.from(CELLS) }, []);
  const scene = {
    info: { splats: 80 },
    index: { totalChunkCount: 6, rows: sceneRows },
    compensation: {
      layerChunks,
      shifts: (prefix: number, chunk: number) => {
        prefixes.set(chunk, prefix);
        if (prefix === 6) return undefined;
        const added = Float32Array.from({ length: SPLATS[chunk]! }, (_, row) => 1000 * (chunk + 1) + row);
        return { scales: added, opacities: added };
      },
    },
  } as unknown as Scene;
  const layer = {
    capacity,
    compensated: false,
    write: ({ words, count }: PackedSplats, first: number) => {
      for (let i = 0; i < count; i++) rows[first + i] = words[4 * i]!;
    },
    clear: (first: number, count: number) => rows.fill(0, first, first + count),
    // Rows stand along x, by their place in the chunk.
    readMeans: (first: number, means: Float32Array) => {
      for (let i = 0; i < means.length; i += 3) means.set([(8 * (rows[first + i / 3]! % 1000)) / 10, 0, 0], i);
    },
    shift: (first: number, count: number, added: { scales: Float32Array } | undefined) => {
      for (let i = 0; i < count; i++) shifts[first + i] = added?.scales[i] ?? 0;
    },
  };
  const visited = new VisitedScene(scene, layer as unknown as Layer, new Set(), ratios);
  const take = (...chunks: number[]): void => {
    for (const chunk of chunks) {
      const firstRow = SPLATS.slice(0, chunk).reduce((sum, count) => sum + count, 0);
      visited.apply({
        kind: "rows",
        chunk,
        firstRow,
        count: SPLATS[chunk]!,
        tail: true,
        refined: true,
        packed: packedOf(chunk),
      });
    }
  };
  return { visited, prefixes, rows, shifts, layer, take };
}

test("what the pose shows little of is not made up for", () => {
  const unseen = Float64Array.from([1, 1, 1 / 512, 1, 1, 1]);
  for (const [ratios, ofFirst] of [
    [undefined, 2],
    [new Float64Array(6).fill(3), 2],
    [unseen, 5],
  ] as const) {
    const { visited, prefixes, take } = watched(80, () => ratios);
    take(0, 1, 3, 4);
    assert.ok(!visited.work(Infinity));
    // The chunks of the first cell of the second depth are all there, up to the last that came.
    assert.deepEqual([...prefixes].sort(), [
      [0, ofFirst],
      [1, 5],
      [3, 5],
      [4, 5],
    ]);
  }
});

test("where a visitor stands still, chunks are changed for what is seen from there", async () => {
  let ratios = new Float64Array(6).fill(3);
  const { visited, prefixes, take } = watched(80, () => ratios);
  take(0, 1, 3, 4);
  visited.work(Infinity);
  assert.equal(prefixes.get(0), 2);
  ratios = Float64Array.from([1, 1, 1 / 512, 1, 1, 1]);
  assert.ok(!visited.work(Infinity));
  assert.equal(prefixes.get(0), 2);
  visited.poseChanged();
  while (visited.work(Infinity)) await new Promise((resolve) => setTimeout(resolve, 10));
  assert.equal(prefixes.get(0), 5);
});

test("chunks take the rows of those that went, and bring what they add with them", () => {
  const { visited, rows, shifts, layer, take } = watched(50, () => undefined);
  const drawn = (): number[] => rows.filter((word) => word > 0).sort((a, b) => a - b);
  const wanted = (...chunks: number[]): number[] =>
    chunks.flatMap((chunk) => Array.from({ length: SPLATS[chunk]! }, (_, row) => 1000 * (chunk + 1) + row));
  take(0, 1, 3, 4);
  visited.work(Infinity);
  assert.deepEqual(drawn(), wanted(0, 1, 3, 4));
  assert.deepEqual(shifts, rows);
  assert.ok(layer.compensated);
  visited.apply({ kind: "evicted", chunk: 3 });
  visited.apply({ kind: "evicted", chunk: 4 });
  visited.work(Infinity);
  assert.deepEqual(drawn(), wanted(0, 1));
  assert.equal(visited.splats, 20);
  // Thirty rows are free, in two runs around none that is held or in one.
  take(2);
  visited.work(Infinity);
  assert.deepEqual(drawn(), wanted(0, 1, 2));
  for (const [row, added] of shifts.entries())
    assert.ok(added === 0 || added === rows[row], `row ${row} is shifted by ${added}`);
  visited.apply({ kind: "evicted", chunk: 1 });
  take(5);
  visited.work(Infinity);
  assert.deepEqual(drawn(), wanted(0, 2, 5));
  for (const [row, added] of shifts.entries())
    assert.ok(added === 0 || added === rows[row], `row ${row} is shifted by ${added}`);
});

test("behind the layers, splats grow where chunks below are missing", () => {
  const { visited, shifts, take } = watched(80, () => undefined, 1);
  take(0, 1, 2, 3);
  visited.work(Infinity);
  // Rows 3 to 5 of chunk 1 lie in the box of the missing chunk 4, which has 10 splats, of which 8 count.
  const grown = Math.fround(0.25 * (1 + 11 / 3 / 2 - 1));
  assert.deepEqual(shifts.slice(10, 20), [0, 0, 0, grown, grown, grown, 0, 0, 0, 0]);
  // Chunk 3 has nothing below; of chunk 2, chunk 5 is missing.
  assert.deepEqual(shifts.slice(50, 60), new Array<number>(10).fill(0));
  assert.ok(shifts[20 + 5]! > 0);
  take(4);
  visited.work(Infinity);
  assert.deepEqual(shifts.slice(10, 20), new Array<number>(10).fill(0));
});
