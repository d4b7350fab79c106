// What the viewer reads and says: PLY files, where to look, bytes at a rate, sentences.
import assert from "node:assert/strict";
import { test } from "node:test";
import { toPly } from "../src/adapters/ply.js";
import { CogsplatError, SourceError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import { DEFAULT_RANGES, type PackedSplats, unpackSplats } from "../src/scene/packed_splats.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { concatenate, type Splats } from "../src/scene/splats.js";
import { bulkOf, depthAhead } from "../src/viewer/framing.js";
import { Meter } from "../src/viewer/meter.js";
import { formatBytes } from "../src/viewer/numbers.js";
import { OrbitCamera } from "../src/viewer/orbit.js";
import { readPlyHeader } from "../src/viewer/ply_header.js";
import type { PlyResponse } from "../src/viewer/ply_messages.js";
import { readPly } from "../src/viewer/ply_reader.js";
import { NoWebGlError } from "../src/viewer/renderer.js";
import { describeError } from "../src/viewer/sentences.js";
import { vectorBytes } from "./vectors.js";

const kernels = await loadKernels();

async function responses(bytes: Uint8Array, mostRows = Infinity): Promise<PlyResponse[]> {
  const found: PlyResponse[] = [];
  const source = new Blob([bytes as Uint8Array<ArrayBuffer>]);
  const request = { type: "ply", source, mostRows, ranges: DEFAULT_RANGES, bitsPerSecond: Infinity } as const;
  await readPly(request, new Meter(), (response) => found.push(response));
  return found;
}

/** Splats that a seed makes, more than are packed at a time. */
function randomSplats(count: number): Splats {
  let state = 1;
  const random = (length: number, from: number, to: number) =>
    Float32Array.from({ length }, () => {
      state = (state * 48_271) % 2_147_483_647;
      return from + (state / 2_147_483_647) * (to - from);
    });
  const quats = random(4 * count, -1, 1);
  for (let i = 0; i < count; i++) {
    const row = quats.subarray(4 * i, 4 * i + 4);
    const factor = (row[0]! < 0 ? -1 : 1) / Math.hypot(...row);
    row.forEach((value, k) => {
      row[k] = value * factor;
    });
  }
  return {
    count,
    shDegree: 3,
    means: random(3 * count, -4, 4),
    scales: random(3 * count, -6, 0),
    quats,
    opacities: random(count, -4, 4),
    sh0: random(3 * count, -1.5, 1.5),
    shN: random(45 * count, -0.9, 0.9),
  };
}

const largest = (a: Float32Array, b: Float32Array) =>
  a.reduce((most, value, i) => Math.max(most, Math.abs(value - b[i]!)), 0);

test("a PLY is packed within the tolerances of SPEC 8.6, with its means as they are", async () => {
  const splats = randomSplats(20_000);
  const found = await responses(toPly(splats, { origin: [100, 0, -50] }));
  const [first] = found;
  assert.ok(first?.type === "scene");
  assert.equal(first.scene.splats, 20_000);
  assert.equal(first.scene.shDegree, 3);
  assert.deepEqual(first.scene.origin, [0, 0, 0]);
  const packed = found.flatMap((response) => (response.type === "rows" ? [response.packed] : []));
  assert.equal(packed.length, 5);
  const back = concatenate(packed.map(unpackSplats), 3);
  const means = packed.flatMap((part) => Array.from(part.means));
  assert.deepEqual(
    means,
    Array.from(splats.means, (value, i) => Math.fround(value + [100, 0, -50][i % 3]!)),
  );
  assert.ok(largest(back.scales, splats.scales) < 0.05);
  assert.ok(largest(back.sh0, splats.sh0) < 0.02);
  assert.ok(largest(back.shN, splats.shN) < 0.04);
  const last = found.at(-1)!;
  assert.equal(last.type, "end");
});

test("a PLY that ends early gives what is there, and says so", async () => {
  const bytes = toPly(randomSplats(100));
  const found = await responses(bytes.subarray(0, bytes.length - 1));
  assert.deepEqual(
    found.map(({ type }) => type),
    ["scene", "rows", "failed"],
  );
  const [, rows, failed] = found;
  assert.ok(rows?.type === "rows" && failed?.type === "failed");
  assert.equal(rows.packed.count, 99);
  assert.match(failed.message, /99 of 100 splats/);
});

test("of a PLY no more rows are read than are wanted", async () => {
  const found = await responses(toPly(randomSplats(500)), 120);
  const rows = found.flatMap((response) => (response.type === "rows" ? [response.packed.count] : []));
  assert.deepEqual(rows, [120]);
  assert.equal(found.at(-1)!.type, "end");
});

test("what our PLY says of its scene is heard", () => {
  const header = (lines: string[]) =>
    new TextEncoder().encode(
      [
        "ply",
        "format binary_little_endian 1.0",
        ...lines,
        "element vertex 7",
        ...[
          "x",
          "y",
          "z",
          "f_dc_0",
          "f_dc_1",
          "f_dc_2",
          "opacity",
          "scale_0",
          "scale_1",
          "scale_2",
          "rot_0",
          "rot_1",
          "rot_2",
          "rot_3",
        ].map((name) => `property float ${name}`),
        "property uchar label",
        "end_header",
        "",
      ].join("\n"),
    );
  const plain = readPlyHeader(header([]))!;
  assert.equal(plain.stride, 57);
  assert.deepEqual(plain.scene, {
    splats: 7,
    shDegree: 0,
    origin: [0, 0, 0],
    axes: "RDF",
    linear: false,
    kernelPx: 0.3,
    antialiased: false,
    capture: [],
  });
  const told = readPlyHeader(
    header([
      "comment cogsplat origin 1.5 0.0 -2.0",
      "comment cogsplat axes RUB",
      "comment cogsplat kernel_px 0.1",
      "comment cogsplat colour_space linear",
      "comment SplatRenderMode: mip",
      "comment cogsplat capture 1.0 -2.5 3.0 640.0",
      "comment cogsplat capture 1.0 2.0 3.0 0.0",
      "comment cogsplat capture 1.0 2.0 3.0",
    ]),
  )!;
  assert.deepEqual(told.scene, {
    splats: 7,
    shDegree: 0,
    origin: [1.5, 0, -2],
    axes: "RUB",
    linear: true,
    kernelPx: 0.1,
    antialiased: true,
    capture: [{ position: [1, -2.5, 3], focalPx: 640 }],
  });
  assert.equal(readPlyHeader(header([]).subarray(0, 60)), undefined);
  assert.throws(() => readPlyHeader(new TextEncoder().encode("solid cube\nfacet")), /neither a \.cogs file nor a PLY/);
  const mesh = new TextEncoder().encode("ply\nformat ascii 1.0\nelement vertex 3\nend_header\n");
  assert.throws(() => readPlyHeader(mesh), /not binary little-endian/);
});

test("the bulk of a scene is where its small opaque splats are, not in its sky", () => {
  const words = new Uint32Array(4 * 1000);
  const means = new Float32Array(3 * 1000);
  const ends = [1, -1, 10];
  for (let i = 0; i < 1000; i++) {
    const isSky = i % 2 === 1;
    const code = isSky ? 160 : 60;
    words[4 * i] = 255 << 24;
    for (let axis = 0; axis < 3; axis++) means[3 * i + axis] = ends[isSky ? 2 : (i >> (axis + 1)) & 1]!;
    words[4 * i + 3] = code | (code << 8) | (code << 16);
  }
  const packed: PackedSplats = { count: 1000, words, means, sh: [], ranges: DEFAULT_RANGES };
  const bulk = bulkOf(packed, [0, 0, 0])!;
  assert.ok(Math.hypot(...bulk.centre) < 0.01);
  assert.ok(bulk.radius > 1.7 && bulk.radius < 4);
  const moved = bulkOf(packed, [5, 0, 0])!;
  assert.ok(Math.abs(moved.centre[0] + 5) < 0.01);
  assert.ok(Math.abs(depthAhead(packed, [0, 0, 0], [0, 0, -20], [0, 0, 1])! - 20) <= 1.01);
  assert.equal(depthAhead(packed, [0, 0, 0], [0, 0, -20], [0, 0, -1]), undefined);
});

test("an object alone is framed as a whole, but for a splat that floats far off", () => {
  // A person: 2 high (the y axis), 0.6 wide.
  const rows = 1001;
  const words = new Uint32Array(4 * rows);
  const means = new Float32Array(3 * rows);
  for (let i = 0; i < rows; i++) {
    const at = i === rows - 1 ? [0, 50, 0] : [0.3 * Math.cos(i), (2 * i) / (rows - 1) - 1, 0.3 * Math.sin(i)];
    words[4 * i] = 255 << 24;
    means.set(at, 3 * i);
    words[4 * i + 3] = 60 | (60 << 8) | (60 << 16);
  }
  const bulk = bulkOf({ count: rows, words, means, sh: [], ranges: DEFAULT_RANGES }, [0, 0, 0])!;
  assert.ok(Math.hypot(...bulk.centre) < 0.05);
  assert.ok(bulk.radius > 1.2 && bulk.radius < 1.6);
  // From where the camera stands then, every splat but that one is in the picture, on a phone that is held upright too.
  const { scene } = new SceneFile(vectorBytes("valid", "sh0"), kernels());
  for (const [width, height] of [
    [640, 420],
    [300, 650],
  ] as const) {
    const camera = new OrbitCamera({ ...scene, firstView: undefined });
    camera.frame(bulk.centre, bulk.radius);
    const { rotation: r, translation: t, focal } = camera.view(height, width);
    for (const [x, y, z] of [
      [0.3, 1, 0],
      [-0.3, -1, 0],
      [0, 1, 0.3],
      [0, -1, -0.3],
      [0, 1, -0.3],
    ] as const) {
      const p = [0, 1, 2].map((row) => r[3 * row]! * x + r[3 * row + 1]! * y + r[3 * row + 2]! * z + t[row]!);
      assert.ok(p[2]! > 0);
      assert.ok(Math.abs((focal[0] * p[0]!) / p[2]!) < width / 2);
      assert.ok(Math.abs((focal[1] * p[1]!) / p[2]!) < height / 2);
    }
  }
});

test("a PLY comes no faster than the rate, and the page has its turn between two blocks", async () => {
  const bytes = toPly(randomSplats(9000));
  const meter = new Meter();
  // 0.2 seconds for all of it.
  meter.bitsPerSecond = (8 * bytes.length) / 0.2;
  const source = new Blob([bytes as Uint8Array<ArrayBuffer>]);
  let rests = 0;
  const found: string[] = [];
  const start = performance.now();
  const request = { type: "ply", source, mostRows: Infinity, ranges: DEFAULT_RANGES, bitsPerSecond: Infinity } as const;
  await readPly(
    request,
    meter,
    ({ type }) => found.push(type),
    async () => void rests++,
  );
  assert.ok(performance.now() - start >= 190);
  assert.deepEqual([...new Set(found)], ["scene", "rows", "end"]);
  assert.equal(rests, found.filter((type) => type === "rows").length);
  assert.ok(rests >= 2);
  assert.equal(meter.bytes, bytes.length);
});

test("a meter counts bytes and keeps to its rate", async (context) => {
  const pauses: number[] = [];
  context.mock.method(globalThis, "setTimeout", (resolve: () => void, pause: number) => {
    pauses.push(pause);
    resolve();
  });
  // No time passes, so that each pause is for all bytes so far.
  context.mock.method(performance, "now", () => 1000);
  const meter = new Meter();
  async function* parts() {
    for (let i = 0; i < 4; i++) yield new Uint8Array(1000);
  }
  meter.bitsPerSecond = 320_000; // 25 ms a part
  let bytes = 0;
  for await (const part of meter.through(parts())) bytes += part.length;
  assert.equal(bytes, 4000);
  assert.equal(meter.bytes, 4000);
  assert.deepEqual(pauses, [25, 50, 75, 100]);
});

test("every error is told in a sentence of its own", () => {
  const errors = [
    new NoWebGlError("none"),
    new SourceError("gone", 404),
    new SourceError("no", 403),
    new SourceError("trouble", 503),
    new SourceError("unreachable"),
    new CogsplatError("not-cogs", "x"),
    new CogsplatError("file-truncated", "x"),
    new CogsplatError("segment-crc", "x"),
    new CogsplatError("version-major", "x"),
    new CogsplatError("decoded-size", "x"),
    new CogsplatError("source-changed", "x"),
  ];
  const titles = errors.map((error) => describeError(error, false).title);
  assert.equal(new Set(titles).size, errors.length);
  assert.match(describeError(errors[1], false).detail, /404/);
  assert.notEqual(describeError(errors[6], true).detail, describeError(errors[6], false).detail);
  assert.equal(describeError(new Error("odd"), false).detail, "odd");
});

test("sizes are written with three digits", () => {
  assert.deepEqual([0, 999, 1000, 65_536, 999_499, 999_600, 12_345_678, 5e9].map(formatBytes), [
    "0 bytes",
    "999 bytes",
    "1 kB",
    "65.5 kB",
    "999 kB",
    "1 MB",
    "12.3 MB",
    "5 GB",
  ]);
});

test("a scene without a first view is framed, one with it keeps its picture", async () => {
  const { OrbitCamera } = await import("../src/viewer/orbit.js");
  const { scene } = new SceneFile(vectorBytes("valid", "root-values"), kernels());
  const camera = new OrbitCamera(scene);
  const before = camera.view(480);
  camera.turnAround(7);
  camera.view(480).translation.forEach((value, i) => {
    assert.ok(Math.abs(value - before.translation[i]!) < 1e-9);
  });
  const { position } = camera;
  camera.turnInPlace(40, -20);
  camera.position.forEach((value, i) => {
    assert.ok(Math.abs(value - position[i]!) < 1e-9);
  });
  const free = new OrbitCamera({ ...scene, firstView: undefined });
  free.frame([1, 2, 3], 2);
  const { rotation: r, translation: t, focal } = free.view(400);
  const p = [0, 1, 2].map((row) => t[row]! + r[3 * row]! + 2 * r[3 * row + 1]! + 3 * r[3 * row + 2]!);
  assert.ok(Math.abs(p[0]!) < 1e-9 && Math.abs(p[1]!) < 1e-9);
  // The ball fills the height of the picture.
  assert.ok(Math.abs((2 * focal[1]) / p[2]! - 200) < 1e-6);
});

test("a PLY whose body has no end is taken as far as its last row", async () => {
  const bytes = toPly(randomSplats(5000));
  const real = globalThis.fetch;
  let isCancelled = false;
  let parts = 0;
  const body = new ReadableStream<Uint8Array>(
    {
      pull: (controller) => controller.enqueue(parts++ === 0 ? bytes : new Uint8Array(65_536)),
      cancel: () => {
        isCancelled = true;
      },
    },
    { highWaterMark: 0 },
  );
  globalThis.fetch = async () => new Response(body, { headers: { "Content-Length": "abc" } });
  try {
    const found: PlyResponse[] = [];
    const source = "https://example.org/scene.ply";
    const request = {
      type: "ply",
      source,
      mostRows: Infinity,
      ranges: DEFAULT_RANGES,
      bitsPerSecond: Infinity,
    } as const;
    await readPly(request, new Meter(), (response) => found.push(response));
    assert.equal(found.at(-1)!.type, "end");
    assert.equal(found[0]?.type === "scene" && found[0].totalBytes, undefined);
    assert.ok(isCancelled && parts < 4);
  } finally {
    globalThis.fetch = real;
  }
});
