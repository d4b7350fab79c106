import assert from "node:assert/strict";
import { test } from "node:test";
import { axesMatrix, axesRotation } from "../src/adapters/axes.js";
import { streamToBabylon } from "../src/adapters/babylon.js";
import {
  drawBySpec as drawPlayCanvasBySpec,
  type PlayCanvasOptions,
  streamToPlayCanvas,
} from "../src/adapters/playcanvas.js";
import { sortBehindCameras } from "../src/adapters/playcanvas_sorting.js";
import { toPly } from "../src/adapters/ply.js";
import { originPosition } from "../src/adapters/row_stream.js";
import { drawBySpec as drawSparkBySpec, type SparkSplats, streamToSpark } from "../src/adapters/spark.js";
import { loadKernels } from "../src/kernels/load.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { DEFAULT_RANGES, unpackSplats } from "../src/scene/packed_splats.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { concatenate, type Splats } from "../src/scene/splats.js";
import { vectorBytes } from "./vectors.js";

const kernels = await loadKernels();

test("a PLY has every value where 3DGS training puts it", () => {
  const splats = new SceneFile(vectorBytes("valid", "sh2"), kernels()).decode();
  const bytes = toPly(splats, { origin: [1, 2, 3] });
  const text = new TextDecoder("latin1").decode(bytes);
  const end = text.indexOf("end_header\n") + "end_header\n".length;
  const names = [...text.slice(0, end).matchAll(/property float (\w+)/g)].map((match) => match[1]!);
  assert.equal(bytes.length, end + 4 * names.length * splats.count);
  const rows = new Float32Array(bytes.slice(end).buffer);
  const at = (row: number, name: string) => rows[row * names.length + names.indexOf(name)]!;
  for (const row of [0, splats.count - 1]) {
    assert.equal(at(row, "y"), Math.fround(splats.means[3 * row + 1]! + 2));
    assert.equal(at(row, "nz"), 0);
    assert.equal(at(row, "f_dc_2"), splats.sh0[3 * row + 2]);
    // Eight coefficients: f_rest_8 is the first of green, f_rest_23 the last of blue.
    assert.equal(at(row, "f_rest_8"), splats.shN[24 * row + 1]);
    assert.equal(at(row, "f_rest_23"), splats.shN[24 * row + 23]);
    assert.equal(at(row, "opacity"), splats.opacities[row]);
    assert.equal(at(row, "scale_1"), splats.scales[3 * row + 1]);
    assert.equal(at(row, "rot_0"), splats.quats[4 * row]);
  }
});

test("axes become matrices and rotations", () => {
  assert.deepEqual(axesMatrix("RDF"), [1, 0, 0, 0, -1, 0, 0, 0, -1]);
  assert.deepEqual(axesMatrix("RUB"), [1, 0, 0, 0, 1, 0, 0, 0, 1]);
  for (const axes of ["RDF", "RUB", "RFU", "LUF", "BRU", "DRB", "UBR"]) {
    const rotation = axesRotation(axes);
    const matrix = axesMatrix(axes);
    for (const vector of [
      [1, 0, 0],
      [0, 1, 0],
      [0, 0, 1],
    ]) {
      const expected = [0, 1, 2].map((row) => vector.reduce((sum, v, i) => sum + matrix[3 * row + i]! * v, 0));
      rotate(rotation, vector).forEach((value, i) => {
        assert.ok(Math.abs(value - expected[i]!) < 1e-12, axes);
      });
    }
  }
  assert.throws(() => axesRotation("LDF"), RangeError);
});

type Renderer = "spark" | "playcanvas";

for (const layout of ["spark", "playcanvas"] as const) {
  test(`${layout}: a whole scene is uploaded as its chunks decode`, async () => {
    const bytes = vectorBytes("valid", "chunks");
    const scene = await StreamedScene.open(new Blob([new Uint8Array(bytes)]));
    const uploads: number[] = [];
    const { arrays, done } = start(layout, scene, { uploadInterval: 0, onUpload: (rows) => uploads.push(rows) });
    await done;
    const file = new SceneFile(bytes, kernels());
    assertNear(arrays, file.decode());
    assert.equal(uploads.at(-1), scene.info.splats);
  });

  test(`${layout}: rows that are there make up for the others, and no more once all are there`, async () => {
    const bytes = vectorBytes("valid", "compensation");
    const scene = await StreamedScene.open(new Blob([new Uint8Array(bytes)]));
    const file = new SceneFile(bytes, kernels());
    const seen: { prefix: number; arrays: Uint32Array[] }[] = [];
    let rows = 0;
    const { arrays, done } = start(layout, scene, {
      uploadInterval: 0,
      onUpload: (now) => {
        rows = now;
        let prefix = 0;
        for (let sum = 0; sum < now; prefix++) sum += file.index.chunks.splats[prefix]!;
        seen.push({ prefix, arrays: arrays.map((array) => array.slice()) });
      },
    });
    await done;
    assert.equal(rows, scene.info.splats);
    assert.ok(seen.length > 1);
    for (const { prefix, arrays: then } of seen) {
      const chunks = Array.from({ length: prefix }, (_, chunk) => {
        const splats = file.decodeChunk(chunk);
        file.compensate(splats, chunk, prefix);
        return splats;
      });
      assertNear(then, concatenate(chunks, scene.info.shDegree));
    }
  });

  test(`${layout}: what is given back ends the stream`, async () => {
    const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("valid", "chunks"))]));
    const shown = start(layout, scene, {});
    shown.dispose();
    await assert.rejects(shown.done, { name: "AbortError" });
    assert.ok(shown.disposed());
  });
}

test("playcanvas: rows that show nothing stand in the middle of the box", async () => {
  const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("valid", "chunks"))]));
  const { splats, box } = scene.info;
  const leastRows = splats + 100;
  const { done, drawn, centers, arrays } = start("playcanvas", scene, { leastRows });
  await done;
  assert.ok(drawn.at(-1)! >= leastRows);
  const middle = [0, 1, 2].map((i) => Math.fround((box[i]! + box[i + 3]!) / 2));
  for (let row = splats; row < drawn.at(-1)!; row++)
    assert.deepEqual(Array.from(centers.subarray(3 * row, 3 * row + 3)), middle);
  const [colours] = arrays;
  assert.ok(colours!.length >= 4 * drawn.at(-1)!);
  assert.ok(colours!.subarray(0, 4 * splats).some((word) => word !== 0));
  assert.ok(
    colours!.subarray(4 * splats).every((word) => word === 0),
    "without opacity",
  );
});

for (const leastRows of [0, 5000]) {
  test(`playcanvas: no two uploads have the same number of splats, ${leastRows} rows at least`, async () => {
    const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("valid", "chunks"))]));
    const { done, drawn } = start("playcanvas", scene, { leastRows, uploadInterval: 0 });
    await done;
    assert.ok(drawn.length > 3);
    assert.equal(new Set(drawn).size, drawn.length, `${drawn}`);
    assert.ok(drawn.at(-1)! >= Math.max(leastRows, scene.info.splats));
  });
}

test("playcanvas: a view that came while the engine sorted is sorted for, once", () => {
  const told = new Map<string, () => void>();
  const on = (name: string, listener: () => void) => {
    told.set(name, listener);
    return { off: () => told.delete(name) };
  };
  const forward = { x: 0, y: 0, z: -1 };
  let asked = 0;
  const end = sortBehindCameras(
    { on, scene: { on }, systems: { camera: { cameras: [{ entity: { forward } }] } } },
    () => asked++,
  );
  const frame = () => told.get("frameend")!();
  const sorted = () => told.get("gsplat:sorted")!();
  frame();
  sorted();
  frame();
  assert.equal(asked, 1, "the first view");
  sorted();
  frame();
  assert.equal(asked, 1, "the answer to what was asked for");
  forward.x = 0.1;
  frame();
  forward.x = 0.2;
  sorted();
  frame();
  frame();
  assert.equal(asked, 1, "an answer from before the last movement says nothing");
  sorted();
  frame();
  frame();
  assert.equal(asked, 2);
  end();
  assert.equal(told.size, 0);
});

test("scenes with other origins are placed beside each other", async () => {
  const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("valid", "root-values"))]));
  const [x, y, z] = scene.info.origin as [number, number, number];
  assert.deepEqual(originPosition(scene, {}), [0, 0, 0]);
  const matrix = axesMatrix(scene.info.axes);
  const moved = originPosition(scene, { worldOrigin: [x - 1, y - 2, z - 4] });
  [0, 1, 2].forEach((row) => {
    const expected = [1, 2, 4].reduce((sum, v, i) => sum + matrix[3 * row + i]! * v, 0);
    assert.ok(Math.abs(moved[row]! - expected) < 1e-6 * (1 + Math.abs(x) + Math.abs(y) + Math.abs(z)));
  });
});

test("babylon: rows are in the engine's layout, in a world of either handedness", async () => {
  const bytes = vectorBytes("valid", "sh2");
  const expected = new SceneFile(bytes, kernels()).decode();
  for (const useRightHandedSystem of [false, true]) {
    const scene = await StreamedScene.open(new Blob([new Uint8Array(bytes)]));
    const updates: { data: ArrayBuffer; sh: Uint8Array[]; degree: number }[] = [];
    class GaussianSplattingMesh {
      rotationQuaternion: unknown;
      readonly scaling = { x: 1, y: 1, z: 1, set: () => undefined };
      readonly position = { y: 0, set: () => undefined };
      async updateDataAsync(data: ArrayBuffer, sh: Uint8Array[] = [], _parts?: Uint8Array, degree = 0): Promise<void> {
        updates.push({ data, sh, degree });
      }
      dispose(): void {}
    }
    class Quaternion {
      readonly values: number[];
      constructor(...values: number[]) {
        this.values = values;
      }
    }
    const world = { useRightHandedSystem, getEngine: () => ({ getCaps: () => ({ maxTextureSize: 64 }) }) };
    const { mesh, done } = streamToBabylon(scene, { GaussianSplattingMesh, Quaternion }, world);
    await done;
    const { data, sh, degree } = updates.at(-1)!;
    assert.equal(data.byteLength, 32 * expected.count);
    assert.equal(degree, 2);
    assert.deepEqual(
      sh.map(({ length }) => length),
      Array(2).fill(16 * 64 * (Math.ceil(expected.count / 64) + 1)),
    );
    const [floats, codes] = [new Float32Array(data), new Uint8Array(data)];
    for (let row = 0; row < expected.count; row++) {
      for (let axis = 0; axis < 3; axis++) {
        assert.equal(floats[8 * row + axis], expected.means[3 * row + axis]);
        assert.equal(floats[8 * row + 3 + axis], Math.fround(Math.exp(expected.scales[3 * row + axis]!)));
      }
      assert.ok(Math.abs(codes[32 * row + 27]! / 255 - 1 / (1 + Math.exp(-expected.opacities[row]!))) <= 0.51 / 255);
      for (let k = 0; k < 4; k++)
        assert.ok(Math.abs(codes[32 * row + 28 + k]! / 127.5 - 1 - expected.quats[4 * row + k]!) <= 0.51 / 127.5);
      for (let k = 0; k < 24; k++) {
        const value = Math.min(Math.max(expected.shN[24 * row + k]!, -1), 1);
        assert.ok(Math.abs(sh[k >> 4]![16 * row + (k & 15)]! / 127.5 - 1 - value) <= 0.51 / 127.5);
      }
    }
    // Points go where the matrix of the axes takes them.
    const matrix = axesMatrix(scene.info.axes, useRightHandedSystem ? "RUB" : "RUF");
    const point = [1, 2, 3];
    const turned = rotate((mesh.rotationQuaternion as Quaternion).values, [1, 2 * mesh.scaling.y, 3]);
    [0, 1, 2].forEach((row) => {
      const where = point.reduce((sum, value, i) => sum + matrix[3 * row + i]! * value, 0);
      assert.ok(Math.abs(turned[row]! - where) < 1e-9);
    });
  }
});

/** Assert that packed rows are the splats, within the steps of their codes; shifts are rounded to steps as well. */
function assertNear(arrays: readonly Uint32Array[], expected: Splats): void {
  const { count } = expected;
  const [words, ...sh] = arrays as [Uint32Array, ...Uint32Array[]];
  const found = unpackSplats({ count, words: words.subarray(0, 4 * count), sh, ranges: DEFAULT_RANGES });
  const near = (a: ArrayLike<number>, b: Float32Array, step: number, what: string): void => {
    const apart = Array.from(b).findIndex((value, i) => !(Math.abs(a[i]! - value) <= step));
    assert.equal(apart, -1, `${what} ${apart}: ${a[apart]} for ${b[apart]}`);
  };
  const unit = (logits: Float32Array): Float32Array => logits.map((logit) => 1 / (1 + Math.exp(-logit)));
  near(found.means, expected.means, 0.01, "mean");
  near(
    found.scales,
    expected.scales.map((scale) => Math.min(Math.max(scale, -12), 9)),
    21 / 254,
    "scale",
  );
  near(unit(found.opacities), unit(expected.opacities), 1 / 128, "opacity");
}

/** Stream into a renderer that keeps what it is given. */
function start(layout: Renderer, scene: StreamedScene, options: PlayCanvasOptions) {
  let disposed = 0;
  const drawn: number[] = [];
  if (layout === "spark") {
    class PackedSplats {
      numSplats = 0;
      needsUpdate = false;
      readonly extra: Record<string, unknown>;
      constructor(readonly options: { packedArray: Uint32Array; extra: Record<string, unknown> }) {
        this.extra = options.extra;
      }
      dispose(): void {
        disposed++;
      }
    }
    class SplatMesh {
      numSplats = 0;
      readonly quaternion = { set: () => undefined };
      readonly position = { set: () => undefined };
      readonly splats: PackedSplats;
      constructor({ packedSplats }: { packedSplats: SparkSplats }) {
        this.splats = packedSplats as PackedSplats;
      }
      updateVersion(): void {
        assert.equal(this.numSplats, this.splats.numSplats);
        assert.ok(this.splats.needsUpdate);
      }
      dispose(): void {
        disposed++;
      }
    }
    const { mesh, done, dispose } = streamToSpark(scene, { PackedSplats, SplatMesh }, options);
    const bands = ["sh1", "sh2", "sh3"].map((name) => mesh.splats.extra[name] as Uint32Array | undefined);
    const arrays = [mesh.splats.options.packedArray, ...bands].filter((array) => array !== undefined);
    assert.ok(
      arrays.every((array, i) => array.length % ((i === 1 ? 2 : 4) * 2048) === 0),
      "whole lines of Spark's textures",
    );
    return { arrays, done, dispose, disposed: () => disposed === 2, drawn, centers: new Float32Array() };
  }
  const textures = new Map<string, Uint32Array>();
  class GSplatContainer {
    readonly centers: Float32Array;
    readonly gsplatData: { shBands?: number } = {};
    readonly aabb = { center: { set: () => undefined }, halfExtents: { set: () => undefined } };
    constructor(_device: string, splats: number, format: GSplatFormat) {
      this.centers = new Float32Array(3 * splats);
      for (const { name, format: words } of format.streams) textures.set(name, new Uint32Array(words * splats));
    }
    getTexture(name: string) {
      return { lock: () => textures.get(name)!, unlock: () => undefined };
    }
    update(rows: number): void {
      assert.ok(3 * rows <= this.centers.length);
      drawn.push(rows);
    }
    configureMaterialDefines(_defines: Map<string, string>): void {
      throw new Error("the engine's own says that there are no bands");
    }
    destroy(): void {
      disposed++;
    }
  }
  class GSplatFormat {
    constructor(
      _device: string,
      readonly streams: { name: string; format: number }[],
    ) {}
  }
  const pc = { GSplatContainer, GSplatFormat, PIXELFORMAT_RGBA32U: 4, PIXELFORMAT_RG32U: 2 };
  const shown = streamToPlayCanvas<string, GSplatContainer>(scene, pc as never, "device", options);
  const defines = new Map<string, string>();
  shown.resource.configureMaterialDefines(defines);
  assert.equal(defines.get("SH_BANDS"), String(scene.info.shDegree));
  assert.equal(shown.resource.gsplatData.shBands, scene.info.shDegree);
  const { done, resource } = shown;
  const dispose = () => shown.dispose();
  return {
    arrays: [...textures.values()],
    done,
    dispose,
    disposed: () => disposed === 1,
    drawn,
    centers: resource.centers,
  };
}

function rotate([x, y, z, w]: readonly number[], v: readonly number[]): number[] {
  const cross = (a: readonly number[], b: readonly number[]) => [
    a[1]! * b[2]! - a[2]! * b[1]!,
    a[2]! * b[0]! - a[0]! * b[2]!,
    a[0]! * b[1]! - a[1]! * b[0]!,
  ];
  const q = [x!, y!, z!];
  const t = cross(q, v).map((value) => 2 * value);
  const u = cross(q, t);
  return v.map((value, i) => value + w! * t[i]! + u[i]!);
}

const KERNEL = { info: { antialiased: false, kernelPx: 0.3 } as never };

test("spark: a shader that is known gets the Jacobian of SPEC 8.7, another one stays and leaves splats out", () => {
  const line = "vec2 J2 = -(J1 * viewCenter.xy) * invZ;";
  const settings = (vertexShader: string) => ({
    material: { vertexShader, needsUpdate: false },
    preBlurAmount: 0,
    blurAmount: 0.3,
    sortRadial: true,
    maxStdDev: 2.8,
    minAlpha: 0,
    maxPixelRadius: 512,
    clipXY: 1.4,
  });
  const known = settings(`before; ${line} after;`);
  assert.ok(drawSparkBySpec(known, KERNEL));
  assert.match(known.material.vertexShader, /^before; .*clamp\(.*; after;$/);
  assert.ok(known.material.needsUpdate && known.clipXY > 100 && !known.sortRadial);
  // Without antialiasing the kernel makes splats larger, and their opacities stay as they are.
  assert.deepEqual([known.preBlurAmount, known.blurAmount], [0.3, 0]);
  assert.ok(Math.abs(Math.exp(-0.5 * known.maxStdDev ** 2) - 1 / 255) < 1e-9);
  const other = settings("another shader");
  assert.ok(!drawSparkBySpec(other, { info: { antialiased: true, kernelPx: 0.1 } as never }));
  assert.equal(other.material.vertexShader, "another shader");
  assert.equal(other.clipXY, 3);
  assert.deepEqual([other.preBlurAmount, other.blurAmount], [0, 0.1]);
});

test("playcanvas: shaders that are known are edited together or not at all", () => {
  const known = new Map([
    ["gsplatPS", "normExp(A) * gaussianColor.a if (A > 1.0)"],
    ["gsplatCommonVS", "float clip = min(1.0, sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5);"],
    [
      "gsplatCornerVS",
      "a + 0.3; b + 0.3; vec2 J2 = -J1 / vp.z * vp.xy; min(1024.0, min(viewport_size.x, viewport_size.y))",
    ],
  ]);
  const draw = (own: Map<string, string>) => {
    const edited = new Map<string, string>();
    const gsplat = { minPixelSize: 2, antiAlias: true, material: { getShaderChunks: () => edited } };
    const isKnown = drawPlayCanvasBySpec(
      { ShaderChunks: { get: () => own } },
      { graphicsDevice: {}, scene: { gsplat } },
      KERNEL,
    );
    assert.deepEqual([gsplat.minPixelSize, gsplat.antiAlias], [0, false]);
    return { isKnown, edited };
  };
  const { isKnown, edited } = draw(known);
  assert.ok(isKnown);
  assert.deepEqual([...edited.keys()], [...known.keys()]);
  assert.match(edited.get("gsplatCornerVS")!, /^a \+ 1\.2; b \+ 1\.2; .*clamp\(/);
  assert.deepEqual(draw(new Map([...known, ["gsplatPS", "another"]])), { isKnown: false, edited: new Map() });
});
