import assert from "node:assert/strict";
import { getEventListeners } from "node:events";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { loadKernels } from "../src/kernels/load.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { sortMemory, sortSteps, type ViewPlane } from "../src/viewer/depth_order.js";
import { RowSorter } from "../src/viewer/depth_sorter.js";
import { OrbitCamera } from "../src/viewer/orbit.js";
import { plyOf } from "../src/viewer/ply_feed.js";
import { RowSlots } from "../src/viewer/row_slots.js";
import { absoluteAddress, sceneName } from "../src/viewer/scene_name.js";
import type { Vector } from "../src/viewer/vectors.js";
import { axesOf, parseUp, parseView, viewText } from "../src/viewer/view_text.js";
import { type WidgetModel, WidgetSource } from "../src/viewer/widget_source.js";
import { vectorBytes } from "./vectors.js";

const kernels = await loadKernels();

function sortByDepth(means: Float32Array, rows: number, plane: ViewPlane, order: Uint32Array): void {
  for (const _ of sortSteps(means, rows, plane, order, sortMemory(rows)));
}

test("splats are ordered from the farthest to the nearest, each once", () => {
  const rows = 5000;
  const means = Float32Array.from({ length: 3 * rows }, (_, i) => Math.sin(i * 12.9898) * 10);
  const forward = [0.6, 0, -0.8];
  const order = new Uint32Array(rows);
  sortByDepth(means, rows, { forward, depth: 0 }, order);
  assert.deepEqual(
    Array.from(order).sort((a, b) => a - b),
    Array.from({ length: rows }, (_, i) => i),
  );
  const depth = (row: number) => Math.fround(means[3 * row]! * 0.6 - means[3 * row + 2]! * 0.8);
  for (let i = 1; i < rows; i++) assert.ok(depth(order[i]!) <= depth(order[i - 1]!));
});

test("no rounding puts the farthest splat in front", () => {
  const order = new Uint32Array(2);
  for (let i = 1; i < 200; i++) {
    // The farthest depth, 0.1·x, is no float32, and half of these round up.
    sortByDepth(Float32Array.of(i / 2, 0, 0, i, 0, 0), 2, { forward: [0.1, 0, 0], depth: 0 }, order);
    assert.deepEqual(Array.from(order), [1, 0]);
  }
});

test("the farthest splat comes first, however its depth is rounded", () => {
  const rows = 100;
  const order = new Uint32Array(rows);
  for (let turn = 0; turn < 200; turn++) {
    const means = Float32Array.from({ length: 3 * rows }, (_, i) => Math.sin((i + 1) * (turn + 1)) * 10);
    const forward = [Math.cos(turn), 0, Math.sin(turn)];
    sortByDepth(means, rows, { forward, depth: 0 }, order);
    const depths = Array.from(
      { length: rows },
      (_, row) => means[3 * row]! * forward[0]! + means[3 * row + 2]! * forward[2]!,
    );
    const farthest = Math.max(...depths);
    assert.ok(depths[order[0]!]! > farthest - 40 / 65_536);
  }
});

test("near a camera 10 km from the origin, depths that differ by a millimetre are told apart", () => {
  const rows = 2000;
  const position = [9876.5, -12.25, -8765.75];
  const forward = [0.6, 0, -0.8];
  // float32 has steps of a millimetre at 10 km.
  const means = Float32Array.from({ length: 3 * rows }, (_, i) => position[i % 3]! + Math.sin((i + 1) * 12.9898) * 10);
  const depthOf = (row: number) =>
    [0, 1, 2].reduce((sum, axis) => sum + forward[axis]! * (means[3 * row + axis]! - position[axis]!), 0);
  const depth = [0, 1, 2].reduce((sum, axis) => sum + forward[axis]! * position[axis]!, 0);
  const order = new Uint32Array(rows);
  sortByDepth(means, rows, { forward, depth }, order);
  for (let i = 1; i < rows; i++) assert.ok(depthOf(order[i]!) <= depthOf(order[i - 1]!) + 1e-6);
});

test("splats at one depth stay in their order", () => {
  const order = new Uint32Array(4);
  sortByDepth(new Float32Array(12).fill(3), 4, { forward: [0, 0, 1], depth: 0 }, order);
  assert.deepEqual(Array.from(order), [0, 1, 2, 3]);
});

test("rows sorted in slices are in the order that one sort gives", async () => {
  const rows = 200_000;
  const sorter = new RowSorter(rows);
  sorter.add(
    0,
    Float32Array.from({ length: 3 * rows }, (_, i) => Math.sin(i * 12.9898)),
  );
  const plane = { forward: [0.36, 0.48, 0.8], depth: 0.5 };
  const { order } = sorter.sort(rows, plane, undefined);
  const sliced = await sorter.sortInSlices(rows, plane, undefined);
  assert.deepEqual(sliced.order, order);
  assert.equal(sliced.rows, rows);
});

test("the camera starts at the first view", () => {
  const { scene } = new SceneFile(vectorBytes("valid", "root-values"), kernels());
  const first = scene.firstView!;
  const view = new OrbitCamera(scene).view(first.height);
  first.rotation.forEach((value, i) => {
    assert.ok(Math.abs(view.rotation[i]! - value) < 1e-6);
  });
  first.translation.forEach((value, i) => {
    assert.ok(Math.abs(view.translation[i]! - value) < 1e-6 * (1 + Math.abs(value)));
  });
  assert.ok(Math.abs(view.focal[1] - first.fy) < 1e-9);
});

test("the camera goes to a pose, whatever the height of the canvas", () => {
  const { scene } = new SceneFile(vectorBytes("valid", "sh0"), kernels());
  const camera = new OrbitCamera(scene);
  camera.setPose({ height: 200, fx: 300, fy: 280, rotation: [0, 0, 1, 0, 1, 0, -1, 0, 0], translation: [1, 2, 3] });
  const view = camera.view(400);
  assert.deepEqual(view.rotation, [0, 0, 1, 0, 1, 0, -1, 0, 0]);
  assert.deepEqual(view.focal, [600, 560]);
  [1, 2, 3].forEach((value, i) => {
    assert.ok(Math.abs(view.translation[i]! - value) < 1e-9);
  });
});

test("turning keeps the target in the middle and the axes a rotation", () => {
  const { scene } = new SceneFile(vectorBytes("valid", "sh0"), kernels());
  const camera = new OrbitCamera(scene);
  const centre = [0, 1, 2].map((i) => (scene.box[i]! + scene.box[3 + i]!) / 2);
  for (const [dx, dy] of [
    [100, 0],
    [0, 70],
    [-300, 40],
  ] as const) {
    camera.turn(dx, dy);
    const { rotation: r, translation: t } = camera.view(480);
    const p = [0, 1, 2].map((row) => t[row]! + centre.reduce((sum, v, i) => sum + r[3 * row + i]! * v, 0));
    assert.ok(Math.abs(p[0]!) < 1e-9 && Math.abs(p[1]!) < 1e-9 && p[2]! > 0);
    for (let i = 0; i < 3; i++) {
      for (let j = 0; j < 3; j++) {
        const dot = [0, 1, 2].reduce((sum, k) => sum + r[3 * i + k]! * r[3 * j + k]!, 0);
        assert.ok(Math.abs(dot - (i === j ? 1 : 0)) < 1e-9);
      }
    }
  }
});

test("rows that chunks give back are taken again, in pieces where they must be", () => {
  const slots = new RowSlots(10);
  const [a, b, c] = [slots.allocate(3), slots.allocate(3), slots.allocate(4)];
  assert.deepEqual([a, b, c], [[{ first: 0, count: 3 }], [{ first: 3, count: 3 }], [{ first: 6, count: 4 }]]);
  slots.release(a);
  slots.release(c);
  const pieces = slots.allocate(5);
  assert.deepEqual(pieces, [
    { first: 0, count: 3 },
    { first: 6, count: 2 },
  ]);
  assert.throws(() => slots.allocate(3), /2 are free/);
  slots.release(b);
  slots.release(pieces);
  slots.release([{ first: 8, count: 2 }]);
  assert.deepEqual(slots.allocate(10), [{ first: 0, count: 10 }]);
});

test("names of files that are no proper addresses are shown, and do not stop the viewer", async () => {
  for (const [address, name] of [
    ["https://example.org/a/garden.cogs?v=2", "garden.cogs"],
    ["https://example.org/b%C3%A4um%20e.cogs", "bäum e.cogs"],
    ["https://example.org/50%.cogs", "50%.cogs"],
    ["https://example.org/%ff.cogs", "%ff.cogs"],
    ["http://[::1/scene.cogs", "scene.cogs"],
    ["scene.cogs", "scene.cogs"],
  ] as const) {
    assert.equal(sceneName(address), name);
    assert.equal(await plyOf(address), undefined);
  }
  assert.equal(await plyOf("http://[::1/scene.PLY"), "http://[::1/scene.PLY");
  assert.equal(absoluteAddress("50%25.cogs", "https://example.org/a/"), "https://example.org/a/50%25.cogs");
  assert.equal(absoluteAddress("http://[::1/a", "https://example.org/"), "http://[::1/a");
});

test("a read from a notebook ends with its signal, whether or not the kernel answers", async () => {
  const abort = new AbortController();
  const sent: { readonly id: number }[] = [];
  let answer: Parameters<WidgetModel["on"]>[1] = () => undefined;
  const model: WidgetModel = {
    send: (content) => sent.push(content as { id: number }),
    on: (_, act) => (answer = act),
    off: () => undefined,
  };
  const source = new WidgetSource(model, 100);
  const silent = source.read({ offset: 0, length: 10 }, { signal: abort.signal });
  const answered = source.read({ offset: 10, length: 2 }, { signal: abort.signal });
  answer({ type: "bytes", id: sent[1]!.id }, [new DataView(Uint8Array.of(7, 8).buffer)]);
  for await (const part of (await answered).parts) assert.deepEqual([...part], [7, 8]);
  abort.abort(new Error("enough"));
  await assert.rejects(silent, /enough/);
  assert.equal(getEventListeners(abort.signal, "abort").length, 0);
  // An answer that comes too late is dropped.
  answer({ type: "bytes", id: sent[0]!.id }, [new DataView(new ArrayBuffer(10))]);
});

const UPRIGHT = { axes: "RDF", box: [-1, -1, -1, 1, 1, 1], firstView: undefined } as const;

/** Return a point as a camera sees it: right, down, forward. */
function seenBy(camera: OrbitCamera, point: readonly number[]): number[] {
  const { rotation: r, translation: t } = camera.view(480);
  return [0, 1, 2].map((row) => t[row]! + point.reduce((sum, v, i) => sum + r[3 * row + i]! * v, 0));
}

test("what lies before the target follows the pointer", () => {
  for (const [dx, dy] of [
    [30, 0],
    [0, 30],
  ] as const) {
    const camera = new OrbitCamera(UPRIGHT);
    const near = seenBy(camera, [0, 0, -1]);
    camera.turn(dx, dy);
    const after = seenBy(camera, [0, 0, -1]);
    assert.ok(Math.sign(after[0]! - near[0]!) === Math.sign(dx) && Math.sign(after[1]! - near[1]!) === Math.sign(dy));
  }
});

test("turning goes about the scene's up, keeps the horizon level and stops before the poles and the ground", () => {
  const up = [0.6, 0, 0.8];
  const camera = new OrbitCamera({ ...UPRIGHT, up, coreBox: [-1, -1, -1, 1, 1, 1] });
  const upward = (axis: number) =>
    [0, 1, 2].reduce((sum, k) => sum + camera.view(480).rotation[3 * axis + k]! * up[k]!, 0);
  for (const [dx, dy, least, most] of [
    [500, 5000, -1, -0.99],
    [-70, -9000, 0, 0.18],
    [33, 20, -1, 0.18],
  ] as const) {
    camera.turn(dx, dy);
    assert.ok(Math.abs(upward(0)) < 1e-9, "the right axis is level");
    assert.ok(upward(1) < 0, "no picture is upside down");
    assert.ok(upward(2) >= least && upward(2) <= most, `${upward(2)}`);
  }
  camera.isFree = true;
  camera.turn(0, -150);
  assert.ok(upward(2) > 0.5, "unless it is free");
});

test("turning and zooming stay where the viewpoints of training were", () => {
  const ring = [10, 20, 30, 40].flatMap((degrees) =>
    [0, 1, 2, 3].map((quarter) => {
      const [elevation, azimuth] = [(degrees * Math.PI) / 180, (quarter * Math.PI) / 2];
      const level = 5 * Math.cos(elevation);
      const position = [level * Math.sin(azimuth), level * Math.cos(azimuth), 5 * Math.sin(elevation)];
      return { position: position as [number, number, number], focalPx: 500 };
    }),
  );
  const scene = { ...UPRIGHT, up: [0, 0, 1], coreBox: [-1, -1, -1, 1, 1, 1], firstView: undefined };
  const camera = new OrbitCamera({ ...scene, capture: ring });
  const elevation = () => (Math.asin(camera.position[2]! / Math.hypot(...camera.position)) * 180) / Math.PI;
  for (const [pixels, expected] of [
    [9000, 55],
    [-9000, -5],
  ] as const) {
    camera.turn(0, pixels);
    assert.ok(Math.abs(elevation() - expected) < 1e-6, `${elevation()}`);
  }
  for (const [factor, expected] of [
    [1e-3, 2.5],
    [1e3, 10],
  ] as const) {
    camera.zoom(factor);
    assert.ok(Math.abs(Math.hypot(...camera.position) - expected) < 1e-6);
  }
  camera.isFree = true;
  camera.turn(0, 250);
  camera.zoom(10);
  assert.ok(elevation() < -5 || elevation() > 55, "unless it is free");
  assert.ok(Math.abs(Math.hypot(...camera.position) - 100) < 1e-6);
  const unlimited = new OrbitCamera({ ...scene, capture: ring.slice(0, 3) });
  unlimited.zoom(1e-3);
  assert.ok(Math.hypot(...unlimited.position) < 1, "too few viewpoints are no range");
});

test("turning goes around the first view's target, wherever it is in the picture", () => {
  const { scene } = new SceneFile(vectorBytes("valid", "root-values"), kernels());
  const target = scene.firstView!.target!;
  const camera = new OrbitCamera(scene);
  const before = seenBy(camera, target);
  camera.turn(50, 3);
  camera.turn(-20, 40);
  seenBy(camera, target).forEach((value, i) => {
    assert.ok(Math.abs(value - before[i]!) < 1e-9);
  });
  camera.zoom(0.5);
  assert.ok(Math.abs(seenBy(camera, target)[2]! - before[2]! / 2) < 1e-9);
});

const TEXTS = JSON.parse(readFileSync(join(process.cwd(), "..", "..", "tests", "view_text.json"), "utf8")) as {
  poses: {
    text: string;
    up: string;
    position: Vector;
    target: Vector;
    fov: number;
    roll: number;
    rotation: number[];
    written: string;
  }[];
  refused: string[];
  ups: { text: string; up: Vector }[];
  refused_ups: string[];
};

test("texts of poses and directions are those of the command line", () => {
  const close = (found: readonly number[], expected: readonly number[]) =>
    found.every((value, i) => Math.abs(value - expected[i]!) < 1e-9);
  for (const { text, up, position, target, fov, roll, rotation, written } of TEXTS.poses) {
    const view = parseView(text);
    assert.deepEqual(view, { position, target, fov, roll });
    const axes = axesOf(view, parseUp(up));
    assert.ok(close(axes.flat(), rotation), text);
    const distance = Math.hypot(...target.map((value, i) => value - position[i]!));
    assert.equal(viewText(position, axes, distance, fov, parseUp(up)), written);
  }
  for (const { text, up } of TEXTS.ups) assert.ok(close(parseUp(text), up), text);
  for (const text of TEXTS.refused) assert.throws(() => parseView(text), SyntaxError, text);
  for (const text of TEXTS.refused_ups) assert.throws(() => parseUp(text), SyntaxError, text);
});

test("rounding errors of a pose are no coordinates of its text", () => {
  const axes = axesOf(parseView("0,0,-4,0,0,0,45"), [0, -1, 0]);
  assert.equal(viewText([5e-17, -2e-16, -4], axes, 4, 45, [0, -1, 0]), "0,0,-4,0,0,0,45");
  assert.match(viewText([1e-9, 0, -4], axes, 4, 45, [0, -1, 0]), /^1e-9,0,-4,/);
});
