import assert from "node:assert/strict";
import { test } from "node:test";
import type { Index } from "../src/container/scene_index.js";
import { SceneRows } from "../src/container/scene_rows.js";
import { loadKernels } from "../src/kernels/load.js";
import { folders } from "../src/loader/folders.js";
import { LinkEstimate } from "../src/loader/link_estimate.js";
import { PoseHistory } from "../src/loader/pose_history.js";
import { SegmentRequests } from "../src/loader/segment_requests.js";
import { SegmentUnits, type UnitIndex } from "../src/loader/segment_units.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { Visit, type VisitOptions } from "../src/loader/visit.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { sumAlongPath } from "../src/schedule/chunk_ratios.js";
import { IndexRatios } from "../src/schedule/index_ratios.js";
import { type Pose, predictPath } from "../src/schedule/poses.js";
import { Scheduler } from "../src/schedule/scheduler.js";
import { FolderServer } from "./folder_server.js";
import { padSegments } from "./padded_file.js";
import { RangeServer } from "./range_server.js";
import { manifest, sha256, vectorBytes, vectorFolder } from "./vectors.js";

const kernels = await loadKernels();

/** Looks along +z from a place, or turned about by half. */
function looking(back = false, position: readonly number[] = [0, 0, 0]): Pose {
  const sign = back ? -1 : 1;
  return { position, rotation: [sign, 0, 0, 0, 1, 0, 0, 0, sign], tanX: 1, tanY: 1 };
}

/** An index of a first chunk around the eye, one ahead and one behind, each a head, then the refinements. */
function smallIndex(): UnitIndex {
  const boxes = [
    [-9, -9, -9, 9, 9, 9],
    [-1, -1, 4, 1, 1, 6],
    [-1, -1, -6, 1, 1, -4],
  ];
  const rows = new SceneRows();
  const root = {
    start: 0,
    firstSegment: 0,
    segmentCount: 6,
    firstChunk: 0,
    chunkCount: 3,
    pages: [],
    firstRow: 0,
    boxes: Float32Array.from(boxes.flat()),
    contribution: Float64Array.from([1, 1, 1]),
  } as unknown as Index;
  rows.enter(root, { splats: Uint32Array.from([5, 5, 5]), cell: Uint32Array.from([1, 2, 3]) }, []);
  return {
    indexes: [root],
    rows,
    segments: {
      kind: Uint8Array.from([1, 1, 1, 7, 7, 7]),
      owner: Uint32Array.from([0, 1, 2, 0, 1, 2]),
      offset: Float64Array.from([100, 200, 300, 400, 500, 600]),
      length: new Uint32Array(6).fill(100),
    },
    chunks: { until: Uint32Array.from([0, 0, 0]) },
    codebookSegmentsOf: () => [],
  } as unknown as UnitIndex;
}

function unitsOf(index: UnitIndex): SegmentUnits {
  const units = new SegmentUnits(index, 0, false);
  units.enter();
  return units;
}

/** Return the segments of an index in the order that a pose requests. */
function order(index: UnitIndex, pose: Pose): number[] {
  const { units, splats, contribution } = unitsOf(index);
  const ratios = sumAlongPath(new IndexRatios(index.indexes).of, predictPath(pose, pose, 0));
  const nothing = { arrived: new Set<number>(), inFlight: new Set<number>(), received: new Map<number, number>() };
  const { fetch } = new Scheduler(units, splats, contribution).decide(ratios, {
    ...nothing,
    budgetSplats: 0,
    evictedWorths: new Map(),
    bytesPerSecond: Infinity,
    latency: 0,
  });
  return fetch.map((unit) => units[unit]!.segment);
}

test("what the pose shows comes first, behind its parents", () => {
  // What lies around the eye shows most, then all of what is ahead; every head stands behind its parent's.
  assert.deepEqual(order(smallIndex(), looking()), [0, 3, 1, 4, 2, 5]);
  const turned = order(smallIndex(), looking(true));
  assert.ok(turned.indexOf(2) < turned.indexOf(1));
  assert.ok(turned.indexOf(5) < turned.indexOf(4));
});

test("chunks that end are no units", () => {
  const index = smallIndex();
  index.chunks.until[1] = 3;
  assert.deepEqual(
    unitsOf(index).units.map(({ segment }) => segment),
    [0, 2, 3, 5],
  );
});

test("a connection is judged by what has come lately, pauses left aside", () => {
  const link = new LinkEstimate();
  assert.equal(link.bytesPerSecond, 250_000);
  assert.equal(link.latency, 0.1);
  link.recordLatency(0.3);
  assert.equal(link.latency, 0.3);
  link.recordLatency(0.02);
  assert.equal(link.latency, 0.02);
  for (let i = 0; i <= 100; i++) link.recordBytes(10_000, 5 + 0.01 * i);
  assert.ok(Math.abs(link.bytesPerSecond - 1e6) < 1);
  link.pause();
  // A first part after a pause says nothing yet.
  link.recordBytes(10_000, 90);
  assert.ok(Math.abs(link.bytesPerSecond - 1e6) < 1);
  for (let i = 1; i <= 300; i++) link.recordBytes(1000, 90 + 0.01 * i);
  assert.ok(Math.abs(link.bytesPerSecond - 1e5) < 1);
});

test("a path leads on from where a visitor was a quarter of a second ago, until he stands still", () => {
  const poses = new PoseHistory();
  assert.equal(poses.path(0), undefined);
  for (let i = 0; i <= 10; i++) poses.add(looking(false, [0, 0, 0.1 * i]), 0.1 * i);
  const [now, soon] = poses.path(1)!;
  assert.equal(now![0].position[2], 1);
  assert.ok(poses.isMoving);
  // Half a second ahead, at 1 a second.
  assert.ok(Math.abs(soon![0].position[2]! - 1.5) < 1e-9);
  assert.equal(poses.path(1.3)![1]![0].position[2], 1);
  assert.ok(!poses.isMoving);
});

/** Rows of each chunk as they were given last. */
async function visited(scene: StreamedScene, options: VisitOptions, pose: Pose): Promise<Map<number, string>> {
  const visit = await Visit.begin(scene, options);
  visit.setPose(pose);
  const last = new Map<number, string>();
  for await (const change of visit.changes()) {
    if (change.kind === "evicted") assert.fail("there is room for all");
    const { means, opacities, shN } = change.splats!;
    const parent = scene.index.rows.parentOf(change.chunk);
    assert.ok(parent < 0 || last.has(parent), "a chunk before its parent");
    last.set(change.chunk, sha256(means, opacities, shN));
  }
  return last;
}

function wholeRows(bytes: Uint8Array): [number, string][] {
  const file = new SceneFile(bytes, kernels());
  return Array.from({ length: file.index.chunkCount }, (_, chunk) => {
    const { means, opacities, shN } = file.decodeChunk(chunk);
    return [chunk, sha256(means, opacities, shN)];
  });
}

const sorted = (rows: Map<number, string>): [number, string][] => [...rows].sort(([a], [b]) => a - b);

for (const name of ["chunks", "vq", "two-books", "refinements", "view-table", "compensation-cells"]) {
  for (const padding of [0, 70_000]) {
    test(`${name} of ${padding} more bytes a segment is visited to the same rows`, async () => {
      const bytes = vectorBytes("valid", name);
      const server = new RangeServer(padding === 0 ? bytes : padSegments(bytes, padding));
      const url = await server.start();
      try {
        const scene = await StreamedScene.open(url);
        assert.deepEqual(sorted(await visited(scene, { compensate: true }, looking())), wholeRows(bytes));
      } finally {
        await server.stop();
      }
    });
  }
}

for (const { name, manifests } of manifest.folders) {
  for (const ranges of [true, false]) {
    test(`the folder ${name} is visited, on a server ${ranges ? "with" : "without"} ranges`, async () => {
      const server = new FolderServer(vectorFolder("folders", name), { ranges });
      const url = await server.start();
      try {
        for (const [given, standsFor] of Object.entries(manifests)) {
          const scene = await StreamedScene.open(url + given, { folders });
          assert.ok(scene.isFolder);
          assert.deepEqual(sorted(await visited(scene, {}, looking())), wholeRows(vectorBytes("valid", standsFor)));
        }
      } finally {
        await server.stop();
      }
    });
  }
}

for (const isLasting of [false, true]) {
  test(`damage that ${isLasting ? "stays is told and spoils no other chunk" : "passes is asked for once more"}`, async () => {
    const bytes = vectorBytes("valid", "chunks");
    let flips = 0;
    // Behind the first bytes all answers are damaged, or one.
    const server = new RangeServer(padSegments(bytes, 70_000), (_, [, end]) =>
      end > 70_000 && (isLasting || flips++ === 0) ? "flip" : undefined,
    );
    const url = await server.start();
    try {
      const told = new Set<number | undefined>();
      const rows = await visited(await StreamedScene.open(url), { onDamage: (_, chunk) => told.add(chunk) }, looking());
      const whole = wholeRows(bytes);
      assert.equal(told.size > 0, isLasting);
      assert.ok(rows.size > 0 && rows.size + told.size >= whole.length);
      for (const [chunk, hash] of whole) if (!told.has(chunk)) assert.equal(rows.get(chunk), hash);
    } finally {
      await server.stop();
    }
  });
}

test("a server without ranges cannot be visited", async () => {
  const server = new RangeServer(vectorBytes("valid", "chunks"), () => "ignore-range");
  const url = await server.start();
  try {
    await assert.rejects(Visit.begin(await StreamedScene.open(url)), /answers range requests/);
  } finally {
    await server.stop();
  }
});

/** Return a pose at a viewpoint of the vector `view-table`, whose chunks all have the same box around it. */
function viewpoint(file: SceneFile, view: number): Pose {
  const { positions } = file.viewTable()!;
  return {
    position: Array.from(positions.subarray(3 * view, 3 * view + 3)),
    rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1],
    tanX: 1,
    tanY: 1,
  };
}

for (const padding of [0, 70_000]) {
  test(`a scene larger than its budget is visited, ${padding} more bytes`, async () => {
    const bytes = vectorBytes("valid", "view-table");
    const file = new SceneFile(bytes, kernels());
    const server = new RangeServer(padding === 0 ? bytes : padSegments(bytes, padding));
    const url = await server.start();
    const abort = new AbortController();
    try {
      const scene = await StreamedScene.open(url);
      let isSettled = false;
      // Two of its four chunks of three splats.
      const visit = await Visit.begin(scene, {
        signal: abort.signal,
        splatBudget: 6,
        onSettled: (now) => (isSettled = now),
      });
      const held = new Set<number>();
      const ended = (async () => {
        for await (const change of visit.changes()) {
          if (change.kind === "evicted") assert.ok(held.delete(change.chunk));
          else held.add(change.chunk);
          assert.ok(held.size <= 2);
        }
      })();
      const look = async (pose: Pose, expected: number[]): Promise<void> => {
        visit.setPose(pose);
        const isThere = (): boolean => isSettled && expected.every((chunk) => held.has(chunk));
        for (let wait = 0; wait < 500 && !isThere(); wait++) await new Promise((resolve) => setTimeout(resolve, 10));
        assert.deepEqual([...held].sort(), expected);
      };
      await look(viewpoint(file, 0), [2, 3]);
      await look(viewpoint(file, 2), [0, 1]);
      await look(viewpoint(file, 0), [2, 3]);
      // A budget that is lowered is kept at once.
      visit.setSplatBudget(3);
      for (let wait = 0; wait < 500 && held.size > 1; wait++) await new Promise((resolve) => setTimeout(resolve, 10));
      assert.equal(held.size, 1);
      abort.abort();
      await assert.rejects(ended, /abort/i);
    } finally {
      await server.stop();
    }
  });
}

test("bytes of stopped segments are kept up to a limit, the first stopped are dropped", () => {
  const [megabyte, takes] = [1 << 20, [] as ((part: Uint8Array) => void)[]];
  const reader = {
    readParts: (_: unknown, signal: AbortSignal, take: (part: Uint8Array) => void) => {
      takes.push(take);
      return new Promise<void>((_, reject) => signal.addEventListener("abort", () => reject(signal.reason as Error)));
    },
  } as unknown as ConstructorParameters<typeof SegmentRequests>[0];
  const requests = new SegmentRequests(reader, (unit) => ({ offset: 2 * megabyte * unit, length: 2 * megabyte }), {
    received: () => assert.fail("no segment is complete"),
    failed: () => assert.fail("nothing fails"),
    ended: () => undefined,
  });
  for (let unit = 0; unit < 6; unit++) {
    requests.start({ offset: 2 * megabyte * unit, length: 2 * megabyte, segments: [unit] });
    takes[unit]!(new Uint8Array(megabyte));
  }
  // A request in flight keeps its bytes.
  requests.stop([1, 2, 3, 4, 5]);
  assert.deepEqual([...requests.partial.keys()], [0, 3, 4, 5]);
  requests.close();
});

test("as many requests are in flight as share the connection", () => {
  for (const mostRequests of [6, 24]) {
    let asked = 0;
    const reader = {
      mostRequests,
      readParts: (_: unknown, signal: AbortSignal) => {
        asked++;
        return new Promise<void>((_, reject) => signal.addEventListener("abort", () => reject(signal.reason as Error)));
      },
    } as unknown as ConstructorParameters<typeof SegmentRequests>[0];
    const requests = new SegmentRequests(reader, (unit) => ({ offset: 200 * unit, length: 100 }), {
      received: () => assert.fail("no segment is complete"),
      failed: () => assert.fail("nothing fails"),
      ended: () => undefined,
    });
    requests.fillConnection(
      Array.from({ length: 40 }, (_, unit) => unit),
      () => "auto",
    );
    assert.equal(asked, mostRequests);
    requests.close();
  }
});

test("what was stopped goes on from the byte where it was, and what was asked for with it stops as well", async () => {
  const file = Uint8Array.from({ length: 1000 }, (_, i) => i & 255);
  const asked: [number, number, string | undefined][] = [];
  const takes: ((part: Uint8Array) => void)[] = [];
  const reader = {
    mostRequests: 6,
    readParts: (
      range: { offset: number; length: number },
      signal: AbortSignal,
      take: (part: Uint8Array) => void,
      priority?: string,
    ) => {
      asked.push([range.offset, range.length, priority]);
      takes.push(take);
      return new Promise<void>((_, reject) => signal.addEventListener("abort", () => reject(signal.reason as Error)));
    },
  } as unknown as ConstructorParameters<typeof SegmentRequests>[0];
  const came = new Map<number, string>();
  const requests = new SegmentRequests(reader, (unit) => ({ offset: 100 * unit, length: 100 }), {
    received: (unit, payload) => came.set(unit, sha256(payload)),
    failed: () => assert.fail("nothing fails"),
    ended: () => undefined,
  });
  // As much as keeps the connection busy: of 500 bytes a second those of the first unit are enough.
  requests.link.bytesPerSecond = 500;
  requests.fillConnection([8, 9], () => "auto");
  assert.deepEqual(asked.splice(0), [[800, 200, "auto"]]);
  requests.fillConnection([3], () => "auto");
  assert.deepEqual(asked, []);
  requests.close();
  takes.splice(0);
  requests.link.bytesPerSecond = 1e6;
  requests.fillConnection([3, 4, 5, 8], (unit) => (unit === 3 ? "high" : "low"));
  assert.deepEqual(asked, [
    [300, 300, "high"],
    [800, 100, "low"],
  ]);
  takes[0]!(file.slice(300, 450));
  assert.deepEqual([...came.keys()], [3]);
  assert.deepEqual(requests.inFlight, [4, 5, 8]);
  assert.equal(requests.stop([5]), 2);
  assert.deepEqual(requests.inFlight, [8]);
  // Bytes that were on their way are left.
  takes[0]!(file.slice(450, 600));
  assert.deepEqual([...requests.partial], [[4, 50]]);
  requests.fillConnection([4, 5], () => "auto");
  assert.deepEqual(asked.at(-1), [450, 150, "auto"]);
  takes[2]!(file.slice(450, 600));
  assert.deepEqual(
    [...came],
    [3, 4, 5].map((unit) => [unit, sha256(file.slice(100 * unit, 100 * unit + 100))]),
  );
  requests.close();
  assert.deepEqual(requests.inFlight, []);
});
