import assert from "node:assert/strict";
import { test } from "node:test";
import { isClosed, setStates } from "../src/container/chunk_sets.js";
import { type Index, type Page, SceneIndex } from "../src/container/scene_index.js";
import { SceneRows } from "../src/container/scene_rows.js";
import { CogsplatError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import { SegmentUnits } from "../src/loader/segment_units.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { Visit } from "../src/loader/visit.js";
import { SceneFile } from "../src/scene/scene_file.js";
import type { Splats } from "../src/scene/splats.js";
import { visibleInBoxes } from "../src/schedule/chunk_ratios.js";
import { IndexRatios } from "../src/schedule/index_ratios.js";
import type { Pose } from "../src/schedule/poses.js";
import { RangeServer } from "./range_server.js";
import { chain, type Shape, treeFile } from "./tree_file.js";
import { sha256, vectorBytes } from "./vectors.js";

const kernels = await loadKernels();

const POSE: Pose = { position: [0, 0, -9], rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], tanX: 1, tanY: 1 };

/** Files of several chunks, and shapes of trees for each number of chunks. */
const NAMES = ["chunks", "late-book", "refinements", "compensation-cells", "view-table", "levels", "ends"];
const SHAPES: Readonly<Record<string, (chunks: number) => Shape>> = {
  "a chain": (chunks) => chain(chunks, 3),
  "pages alone": (chunks) => ({ chunks: 0, pages: Array.from({ length: chunks }, () => ({ chunks: 1 })) }),
  "pages of pages": (chunks) => ({
    chunks: 1,
    pages: [{ chunks: 0, pages: [{ chunks: 1, pages: [] }] }, { chunks: chunks - 2 }],
  }),
};

function hashOf({ means, scales, opacities, shN }: Splats): string {
  return sha256(means, scales, opacities, shN);
}

function wholeRows(bytes: Uint8Array): Map<number, string> {
  const file = new SceneFile(bytes, kernels());
  return new Map(Array.from({ length: file.index.chunkCount }, (_, chunk) => [chunk, hashOf(file.decodeChunk(chunk))]));
}

const inOrder = <T>(rows: ReadonlyMap<number, T>): [number, T][] => [...rows].sort(([a], [b]) => a - b);

async function served(bytes: Uint8Array, work: (url: string, server: RangeServer) => Promise<void>): Promise<void> {
  const server = new RangeServer(bytes);
  try {
    await work(await server.start(), server);
  } finally {
    await server.stop();
  }
}

for (const name of NAMES) {
  const flat = vectorBytes("valid", name);
  const { index } = new SceneFile(flat, kernels());
  for (const [shape, of] of Object.entries(SHAPES)) {
    test(`${name} as ${shape} reads as the file without pages`, async () => {
      const bytes = treeFile(flat, of(index.chunkCount));
      const file = new SceneFile(bytes, kernels());
      assert.ok(file.index.complete && file.index.pages.length > 0);
      assert.deepEqual(file.index.chunks, index.chunks);
      assert.deepEqual(inOrder(wholeRows(bytes)), inOrder(wholeRows(flat)));
      await file.verify();
    });

    test(`beginnings of ${name} as ${shape} have the chunks whose heads and pages are there`, () => {
      const bytes = treeFile(flat, of(index.chunkCount));
      const whole = new SceneFile(bytes, kernels());
      const { indexes, segments, rootLength } = whole.index;
      for (let length = 64 + rootLength; length <= bytes.length; length += 97) {
        const part = new SceneFile(bytes.slice(0, length), kernels(), { partial: true });
        const ends = Array.from({ length: index.chunkCount }, (_, chunk) => {
          const { head } = whole.index.chunkSegments(chunk);
          const books = whole.index.codebookSegmentsOf(head, 0);
          return Math.max(...[head, ...books].map((segment) => segments.offset[segment]! + segments.length[segment]!));
        });
        const missing = ends.findIndex((end) => end > length);
        assert.equal(part.prefixChunks, missing < 0 ? ends.length : missing);
        assert.ok(part.index.indexes.length <= indexes.length);
      }
    });
  }
}

test("a level of a missing page is refused", () => {
  const bytes = vectorBytes("valid", "levels-pages");
  const { index, scene } = new SceneFile(bytes, kernels());
  for (const page of index.pages) {
    const part = new SceneFile(bytes.slice(0, page.offset), kernels(), { partial: true });
    scene.levels.forEach(({ chunks }, level) => {
      if (chunks <= page.firstChunk) part.decode(0, true, level);
      else assert.throws(() => part.decode(0, true, level), { code: "file-truncated" });
    });
  }
});

for (const padding of [0, 70_000]) {
  for (const [shape, of] of Object.entries(SHAPES)) {
    test(`${shape} of ${padding} more bytes is streamed and visited to the same rows`, async () => {
      for (const name of ["compensation-cells", "chunks"]) {
        const flat = vectorBytes("valid", name);
        const whole = inOrder(wholeRows(flat));
        await served(treeFile(flat, of(whole.length), padding), async (url) => {
          const streamed = new Map<number, string>();
          const scene = await StreamedScene.open(url);
          for await (const { chunk, firstRow, splats } of scene.stream({ compensate: true })) {
            assert.equal(firstRow, scene.index.rows.splatsBefore(chunk));
            streamed.set(chunk, hashOf(splats!));
          }
          assert.deepEqual(inOrder(streamed), whole);
          for (const again of [await StreamedScene.open(url), scene]) {
            const visit = await Visit.begin(again, { compensate: true });
            visit.setPose(POSE);
            const visited = new Map<number, string>();
            for await (const change of visit.changes()) {
              assert.ok(change.kind === "rows");
              visited.set(change.chunk, hashOf(change.splats!));
            }
            assert.deepEqual(inOrder(visited), whole);
            assert.equal(visit.ratios()!.length, again.index.rows.count);
          }
        });
      }
    });
  }
}

test("a visit and a stream share the pages that either reads", async () => {
  const flat = vectorBytes("valid", "compensation-cells");
  const whole = inOrder(wholeRows(flat));
  await served(treeFile(flat, SHAPES["pages alone"]!(whole.length), 70_000), async (url, server) => {
    const scene = await StreamedScene.open(url);
    const visit = await Visit.begin(scene);
    visit.setPose(POSE);
    const visited = new Map<number, string>();
    const streamed = new Map<number, string>();
    await Promise.all([
      (async () => {
        for await (const change of visit.changes()) {
          if (change.kind === "rows") visited.set(change.chunk, hashOf(change.splats!));
        }
      })(),
      (async () => {
        for await (const { chunk, splats } of scene.stream()) streamed.set(chunk, hashOf(splats!));
      })(),
    ]);
    assert.deepEqual([inOrder(visited), inOrder(streamed)], [whole, whole]);
    assert.ok(server.ranges.length > 1);
  });
});

test("a page behind others is read first where the pose shows it alone", async () => {
  const flat = vectorBytes("valid", "chunks");
  // A row of boxes along x, of which the pose sees the third.
  const boxes = [-20, -10, 0, 10].flatMap((x) => [x - 1, -1, 4, x + 1, 1, 6]);
  const bytes = treeFile(flat, { chunks: 0, pages: [1, 1, 1, 1].map((chunks) => ({ chunks })) }, 70_000, boxes);
  await served(bytes, async (url) => {
    const scene = await StreamedScene.open(url);
    const abort = new AbortController();
    const visit = await Visit.begin(scene, { signal: abort.signal, splatBudget: 12 });
    visit.setPose({ ...POSE, position: [0, 0, 0], tanX: 0.3, tanY: 0.3 });
    for await (const change of visit.changes()) {
      assert.deepEqual([change.kind, change.chunk], ["rows", 2]);
      break;
    }
    assert.ok(!scene.index.complete && scene.index.isRead(scene.index.pages[2]!));
  });
});

test("a page that cannot be had is told, and spoils no other", async () => {
  const flat = vectorBytes("valid", "chunks");
  const bytes = treeFile(flat, { chunks: 1, pages: [{ chunks: 1 }, { chunks: 2 }] }, 70_000);
  const { pages } = SceneIndex.open(bytes);
  const at = pages[1]!.offset;
  for (const isLasting of [false, true]) {
    let flips = 0;
    const server = new RangeServer(bytes, (_, [start, end]) =>
      start <= at && end >= at && (isLasting || flips++ === 0) ? "flip" : undefined,
    );
    const url = await server.start();
    try {
      const told: unknown[] = [];
      const scene = await StreamedScene.open(url);
      const visit = await Visit.begin(scene, { onDamage: (error) => told.push((error as CogsplatError).code) });
      visit.setPose(POSE);
      const chunks = new Set<number>();
      for await (const change of visit.changes()) chunks.add(change.chunk);
      assert.ok(chunks.has(0));
      if (isLasting) assert.ok(told.length > 0 && !scene.index.complete);
      else assert.deepEqual([[...chunks].sort(), told], [[0, 1, 2, 3], []]);
    } finally {
      await server.stop();
    }
  }
});

function refusedWith(code: string): (error: unknown) => boolean {
  return (error) => error instanceof CogsplatError && error.code === code;
}

test("a page that breaks a rule is refused each time that it is read, and stays unread", () => {
  const bytes = vectorBytes("invalid", "page-head");
  const index = SceneIndex.open(bytes);
  const page = index.nextPage()!;
  const read = (): void => index.addPage(page, bytes.slice(page.offset, page.offset + page.length));
  for (let time = 0; time < 2; time++) assert.throws(read, refusedWith("chunk-heads"));
  assert.ok(!index.isRead(page));
  assert.equal(index.nextPage(), page);
});

test("pages nest three deep", () => {
  const flat = vectorBytes("valid", "compensation");
  assert.ok(new SceneFile(treeFile(flat, chain(5, 3)), kernels()).index.complete);
  assert.throws(() => new SceneFile(treeFile(flat, chain(5, 4)), kernels()), refusedWith("root-value"));
});

test("what the root lists gains the less the further behind, and what a page lists by its chunk's contribution", () => {
  for (const name of ["pages", "pages-tree", "attributes-pages", "compensation-cells-pages"]) {
    const { index } = new SceneFile(vectorBytes("valid", name), kernels());
    const units = new SegmentUnits(index, 3, true);
    units.enter();
    const { owner, length } = index.segments;
    const [root, ...pages] = index.indexes as [Index, ...Index[]];
    const ownOf = ({ firstSegment, segmentCount }: Index): typeof units.units =>
      units.units.filter(({ segment }) => segment >= firstSegment && segment < firstSegment + segmentCount);
    const picture = root.contribution.reduce((sum, value) => sum + value, 0) || 1;
    const begin = index.range(0).offset;
    for (const { segment, gain } of ownOf(root)) {
      const { offset, length: bytes } = index.range(segment);
      assert.equal(gain, picture * (begin / (offset + bytes)) * (bytes / (offset + bytes)));
    }
    for (const page of pages) {
      assert.equal(
        units.units[units.of(-1 - page.page!.number)]!.gain,
        Math.max(page.page!.contribution, 1e-12 * picture),
      );
      const endOf = (segment: number): number => index.range(segment).offset + length[segment]! - page.start;
      for (const { segment, gain, row, isHead } of ownOf(page)) {
        if (row < 0) continue;
        const { head } = index.chunkSegments(owner[segment]!);
        const whole = Math.max(page.contribution[owner[segment]! - page.firstChunk]!, 1e-12 * picture);
        const share = (length[segment]! / length[head]!) * (endOf(head) / endOf(segment)) ** 2;
        assert.ok(Math.abs(gain - whole * share) <= 1e-12 * gain, `segment ${segment} of ${name}`);
        assert.ok(!isHead || share === 1);
      }
    }
  }
});

test("an unread page is a unit behind the head of its parent, and its rows replace it", () => {
  const flat = vectorBytes("valid", "compensation-cells");
  const bytes = treeFile(flat, { chunks: 3, pages: [{ chunks: 4 }] });
  const index = SceneIndex.open(bytes);
  const units = new SegmentUnits(index, 0, false);
  assert.deepEqual(units.enter(), []);
  const [page] = index.pages as [Page];
  const unit = units.of(-1);
  assert.deepEqual(units.ofRow(page.row), [unit]);
  const { row, isHead, size, dependencies } = units.units[unit]!;
  assert.deepEqual([row, isHead, size], [page.row, true, page.length]);
  const parent = index.rows.parents[page.row]!;
  assert.deepEqual(dependencies, parent < 0 ? [] : units.ofRow(parent).slice(0, 1));
  assert.equal(units.splats[page.row], Math.ceil(page.splats / 4));
  index.addPage(page, bytes.slice(page.offset, page.offset + page.length));
  assert.ok(units.isBehind);
  assert.deepEqual(units.enter(), [unit]);
  assert.deepEqual([units.units[unit]!.row, units.units[unit]!.isHead], [-1, false]);
  assert.equal(units.splats.length, index.rows.count);
  assert.equal(units.units.filter(({ isHead: isHeadOfChunk }) => isHeadOfChunk).length, index.chunkCount);
});

/** An index of chunks and pages of some cells, for rows alone. */
function indexOf(page: Page | undefined, firstChunk: number, chunks: number, firstRow: number, pages: Page[]): Index {
  return { page, firstChunk, chunkCount: chunks, firstRow, pages } as unknown as Index;
}

test("parents are in the index of a chunk or above it, and an unread page counts as a chunk that is not there", () => {
  const rows = new SceneRows();
  const pages: Page[] = [];
  const root = indexOf(undefined, 0, 2, 0, pages);
  const pageOf = (firstChunk: number, chunks: number, splats: number, firstSplat: number, row: number): Page =>
    ({ firstChunk, chunks, splats, firstSplat, row, listedBy: root }) as unknown as Page;
  pages.push(pageOf(2, 2, 20, 20, 2), pageOf(4, 2, 30, 40, 3));
  // The root has the whole and one half; its pages are the other half and a quarter of the first.
  rows.enter(root, { splats: Uint32Array.of(10, 10), cell: Uint32Array.of(1, 2) }, [3, 4]);
  assert.deepEqual([...rows.inFileOrder()], [0, 1, 2, 3]);
  assert.deepEqual(rows.parents, [-1, 0, 0, 1]);
  assert.deepEqual(
    [0, 1, 2, 3, 4, 6].map((chunk) => rows.splatsBefore(chunk)),
    [0, 10, 20, undefined, 40, 70],
  );
  // Without layers beyond the first chunk: of 70 splats the first has 20, of 40 the second 10.
  assert.deepEqual(setStates([0, 1], rows, 1), [
    { prefix: 2, share: (20 - 10) / (70 - 10) },
    { prefix: 2, share: 10 / 40 },
  ]);
  assert.deepEqual(setStates([0, 1], rows, 2), [
    { prefix: 2, share: undefined },
    { prefix: 2, share: undefined },
  ]);
  rows.enter(indexOf(pages[1], 4, 2, 4, []), { splats: Uint32Array.of(10, 20), cell: Uint32Array.of(4, 9) }, []);
  assert.deepEqual([...rows.inFileOrder()], [0, 1, 2, 4, 5]);
  assert.deepEqual([rows.parentOf(4), rows.parentOf(5)], [1, 4]);
  assert.ok(isClosed([0, 1, 4], rows));
  assert.ok(!isClosed([0, 4], rows));
  // Chunk 4 is in the set and the page before it is not: the prefix of the first chunk ends before chunk 2 … 4.
  assert.deepEqual(setStates([0, 1, 4], rows, 5), [
    { prefix: 2, share: undefined },
    { prefix: 5, share: undefined },
    { prefix: 5, share: undefined },
  ]);
  rows.enter(indexOf(pages[0], 2, 2, 6, []), { splats: Uint32Array.of(5, 15), cell: Uint32Array.of(3, 3) }, []);
  assert.deepEqual([...rows.inFileOrder()], [0, 1, 6, 7, 4, 5]);
  // Two chunks of one cell: the later adds to the earlier; chunk 0 has 30 in the set, and 25 up to chunk 3.
  assert.deepEqual([rows.parentOf(2), rows.parentOf(3)], [0, 2]);
  assert.equal(setStates([0, 1, 4], rows, 6)[0]!.prefix, 3);
});

test("ratios are those of one index with all chunks of the indexes read, and with the pages that are not", () => {
  const flat = vectorBytes("valid", "chunks");
  const bytes = treeFile(flat, { chunks: 1, pages: [{ chunks: 2 }, { chunks: 1 }] });
  const { index } = new SceneFile(bytes, kernels());
  const [root, first, second] = index.indexes as [Index, Index, Index];
  const found = new IndexRatios([root, first]).of(POSE);
  const visible = [root, first].map(({ boxes, contribution }) => [...visibleInBoxes(boxes, contribution)(POSE)]);
  const contributions = [root, first].map(({ contribution }) => [...contribution]);
  // Row 1 of the root is the page that is read.
  const known = (of: number[][]): number => of[0]![0]! + of[0]![2]! + of[1]![0]! + of[1]![1]!;
  const ratio = (index: number, row: number): number => {
    const share = visible[index]![row]! / known(visible);
    return Math.max(share / (contributions[index]![row]! / known(contributions)), 1 / 512);
  };
  const expected = [ratio(0, 0), ratio(0, 2), ratio(1, 0), ratio(1, 1)];
  const rows = [0, 2, first.firstRow, first.firstRow + 1];
  for (const [k, row] of rows.entries()) assert.ok(Math.abs(found[row]! - expected[k]!) <= 1e-12 * expected[k]!);
  const all = new IndexRatios([root, first, second]).of(POSE);
  assert.equal(all.length, second.firstRow + 1);
});
