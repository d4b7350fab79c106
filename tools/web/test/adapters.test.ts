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
import { type ShadedOptions, uniformsOf } from "../src/adapters/shaded_scene.js";
import { drawBySpec as drawSparkBySpec, type SparkSplats, streamToSpark } from "../src/adapters/spark.js";
import { loadKernels } from "../src/kernels/load.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { toHalf } from "../src/scene/half_floats.js";
import { DEFAULT_RANGES, unpackSplats } from "../src/scene/packed_splats.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { concatenate, type Splats } from "../src/scene/splats.js";
import { FRAGMENT_SHADER, VERTEX_SHADER } from "../src/viewer/shaders.js";
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

type Renderer = "spark" | "playcanvas" | "babylon";

for (const layout of ["spark", "playcanvas", "babylon"] as const) {
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

test("babylon: points go where the axes take them, in a world of either handedness", async () => {
  for (const useRightHandedSystem of [false, true]) {
    const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("valid", "sh2"))]));
    const { mesh, done } = inBabylon(scene, {}, useRightHandedSystem);
    await done;
    const matrix = axesMatrix(scene.info.axes, useRightHandedSystem ? "RUB" : "RUF");
    const point = [1, 2, 3];
    const turned = rotate(mesh.rotationQuaternion as number[], [1, 2 * mesh.scaling.y, 3]);
    [0, 1, 2].forEach((row) => {
      const where = point.reduce((sum, value, i) => sum + matrix[3 * row + i]! * value, 0);
      assert.ok(Math.abs(turned[row]! - where) < 1e-9);
    });
    // The engine takes the box of the mesh from its positions.
    for (const [first, extreme] of [Math.min, Math.max].entries()) {
      const corner = [0, 1, 2].map((axis) => extreme(...mesh.positions.filter((_, i) => i % 3 === axis)));
      assert.deepEqual(corner, Array.from(Float32Array.from(scene.info.box).subarray(3 * first, 3 * first + 3)));
    }
  }
});

test("no comment of the shaders has a semicolon, after which Babylon.js breaks lines for WebGPU", () => {
  for (const shader of [VERTEX_SHADER, FRAGMENT_SHADER]) assert.doesNotMatch(shader, /\/\/.*;/);
});

test("the uniforms of a picture are the same in a world of either handedness", () => {
  const [near, far] = [0.5, 100];
  const projection = (front: 1 | -1) => [
    ...[1.5, 0, 0, 0, 0, 2, 0, 0],
    ...[0.1 * front, 0.2 * front, (front * (far + near)) / (far - near), front],
    ...[0, 0, (-2 * far * near) / (far - near), 0],
  ];
  const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const world = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 3, 4, 5, 1];
  const mirrored = world.map((value, i) => (i % 4 === 2 ? -value : value));
  const left = uniformsOf({ view: identity, projection: projection(1) }, world, [200, 100]);
  const right = uniformsOf({ view: identity, projection: projection(-1) }, mirrored, [200, 100]);
  const zeros = (text: string) => text.replaceAll("-0", "0");
  assert.equal(zeros(JSON.stringify(left)), zeros(JSON.stringify(right)));
  const { rotation, translation, cameraPosition, focal, depth, middle } = left.uniforms as Record<string, number[]>;
  assert.deepEqual(translation!.map(Math.abs), [0, 0, 0]);
  assert.deepEqual([rotation![0], rotation![4], rotation![8]], [2, -2, 2]);
  assert.deepEqual(cameraPosition, [-1.5, -2, -2.5]);
  assert.deepEqual(
    [focal, middle],
    [
      [150, 100],
      [0.1, 0.2],
    ],
  );
  for (const [z, expected] of [
    [near, -1],
    [far, 1],
  ] as const) {
    assert.ok(Math.abs(depth![0]! + depth![1]! / z - expected) < 1e-12);
  }
});

/** Return rows of the shaders as packed words, their means as half floats. */
function packedWords(splats: Uint32Array, shapes: Uint32Array, count: number): Uint32Array {
  const means = new Float32Array(splats.buffer);
  return Uint32Array.from({ length: 4 * count }, (_, i) => {
    const row = Math.floor(i / 4);
    const half = (axis: number) => toHalf(means[4 * row + axis]!);
    if (i % 4 === 0) return splats[4 * row + 3]!;
    if (i % 4 === 1) return half(0) | (half(1) << 16);
    if (i % 4 === 2) return (shapes[2 * row]! & 0xffff0000) | half(2);
    return shapes[2 * row + 1]!;
  });
}

/** Assert that packed rows are the splats, within the steps of their codes; shifts are rounded to steps as well. */
function assertNear(arrays: readonly Uint32Array[], expected: Splats): void {
  const { count } = expected;
  const [splats, second] = arrays as [Uint32Array, Uint32Array];
  // Rows of the shaders have a texture of shapes; the first band of packed rows has as many words.
  const isShaded = arrays.length === expected.shDegree + 2;
  const words = isShaded ? packedWords(splats, second, count) : splats.subarray(0, 4 * count);
  const found = unpackSplats({ count, words, sh: arrays.slice(isShaded ? 2 : 1), ranges: DEFAULT_RANGES });
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
  if (layout === "babylon") {
    const { done, dispose, textures, disposed } = inBabylon(scene, options, true);
    const [splats, shapes, _order, ...bands] = textures.map(({ data }) => data);
    const arrays = [splats!, shapes!, ...bands];
    return { arrays, done, dispose, disposed, drawn, centers: new Float32Array() };
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

/** Stream into a world of Babylon.js that keeps what it is given. */
function inBabylon(scene: StreamedScene, options: ShadedOptions, useRightHandedSystem: boolean) {
  let disposed = 0;
  const dispose = () => {
    disposed++;
  };
  const textures: RawTexture[] = [];
  class RawTexture {
    readonly dispose = dispose;
    constructor(
      readonly data: Uint32Array,
      readonly width: number,
      readonly height: number,
      readonly format: number,
    ) {
      const words = { 8: 1, 9: 2, 11: 4 }[format]!;
      assert.equal(data.length, words * width * height);
      textures.push(this);
    }
    update(data: Uint32Array): void {
      assert.equal(data, this.data);
    }
  }
  class ShaderMaterial {
    alphaMode = 0;
    backFaceCulling = true;
    disableDepthWrite = false;
    readonly onBindObservable = { add: () => undefined };
    readonly dispose = dispose;
    setTexture(_name: string, texture: RawTexture): void {
      assert.ok(textures.includes(texture));
    }
    getEffect(): undefined {}
  }
  class Mesh {
    material: unknown;
    isUnIndexed = false;
    isPickable = true;
    forcedInstanceCount = 0;
    rotationQuaternion: unknown;
    positions: Float32Array = new Float32Array();
    readonly scaling = { y: 1 };
    readonly position = { set: () => undefined };
    readonly dispose = dispose;
    setVerticesData(_kind: string, values: Float32Array): void {
      this.positions = values;
    }
    getWorldMatrix = () => ({ m: [] });
  }
  function Quaternion(...values: number[]) {
    return values;
  }
  const world = {
    useRightHandedSystem,
    activeCamera: null,
    getViewMatrix: () => ({ m: [] }),
    getProjectionMatrix: () => ({ m: [] }),
    getEngine: () => ({ getRenderWidth: () => 1, getRenderHeight: () => 1 }),
  };
  const module = { Mesh, ShaderMaterial, RawTexture, Quaternion: Quaternion as never };
  const shown = streamToBabylon(scene, module, world, options);
  return { ...shown, textures, disposed: () => disposed === 2 + textures.length };
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

const KERNEL = { info: { antialiased: false, kernelPx: 0.3, capture: [] } as unknown as StreamedScene["info"] };
const TRAINED = { info: { ...KERNEL.info, capture: [{ position: [1, 2, 3], focalPx: 10 }] as const } };
/** Twice as large and shifted along x, seen from 5 before the zero: the viewpoint is at 7, 4, 1. */
const MOVED = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 5, 0, 0, 1];
const VIEW = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -5, 1];
const SEEN = [7, 4, 1, 1 / 100];
/** Turned by half a turn about z: the viewpoint is at −1, −2, −2. */
const TURNED = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const TURNED_SEEN = [-1, -2, -2, 1 / 100];
const STRETCHED = [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2, 0, 5, 0, 0, 1];

/** Settings of a renderer of Spark with a vertex shader; `cameras` are those it has drawn. */
function sparkSettings(vertexShader: string) {
  const cameras: unknown[] = [];
  return {
    material: { vertexShader, needsUpdate: false, uniforms: {} as Record<string, { value: unknown }> },
    ...{ preBlurAmount: 0, blurAmount: 0.3, sortRadial: true, maxStdDev: 2.8, minAlpha: 0 },
    ...{ maxPixelRadius: 512, clipXY: 1.4, cameras },
    onBeforeRender(_renderer: never, _scene: never, camera: unknown): void {
      assert.equal(this.cameras, cameras);
      cameras.push(camera);
    },
  };
}

const JACOBIAN = "vec2 J2 = -(J1 * viewCenter.xy) * invZ;";
const SPARK_SHADER = `uniform float preBlurAmount; ${JACOBIAN} a += preBlurAmount; d += preBlurAmount;
  float fullBlurAmount = blurAmount; clamp(sqr(focusRadius), blurAmount, 1.0);`;
const mesh = { matrixWorld: { elements: MOVED } };

test("spark: a shader that is known gets the Jacobian of SPEC 8.7, another one stays and leaves splats out", () => {
  const known = sparkSettings(`before; ${JACOBIAN} after;`);
  assert.ok(drawSparkBySpec(known, KERNEL, mesh));
  assert.match(known.material.vertexShader, /^before; .*clamp\(.*; after;$/);
  assert.ok(known.material.needsUpdate && known.clipXY > 100 && !known.sortRadial);
  // Without antialiasing the kernel makes splats larger, and their opacities stay as they are.
  assert.deepEqual([known.preBlurAmount, known.blurAmount], [0.3, 0]);
  assert.ok(Math.abs(Math.exp(-0.5 * known.maxStdDev ** 2) - 1 / 255) < 1e-9);
  const other = sparkSettings("another shader");
  assert.ok(!drawSparkBySpec(other, { info: { ...TRAINED.info, antialiased: true, kernelPx: 0.1 } }, mesh));
  assert.equal(other.material.vertexShader, "another shader");
  assert.equal(other.clipXY, 3);
  assert.deepEqual([other.preBlurAmount, other.blurAmount], [0, 0.1]);
});

test("spark: splats are as thick as trained where the shader is known and the scene has viewpoints", () => {
  const trained = sparkSettings(SPARK_SHADER);
  assert.ok(drawSparkBySpec(trained, TRAINED, mesh));
  assert.match(trained.material.vertexShader, /a \+= preBlurAmount \* share; d \+= preBlurAmount \* share;/);
  const camera = { matrixWorldInverse: { elements: VIEW } };
  trained.onBeforeRender({} as never, {} as never, camera);
  assert.deepEqual(trained.cameras, [camera]);
  const { trainingPixel, trainingRest } = trained.material.uniforms;
  assert.deepEqual([trainingPixel!.value, trainingRest!.value], [SEEN, 0]);
  for (const info of [KERNEL.info, { ...TRAINED.info, antialiased: true }]) {
    const usual = sparkSettings(SPARK_SHADER);
    assert.ok(drawSparkBySpec(usual, { info }, mesh));
    assert.ok(!usual.material.vertexShader.includes("trainingPixel"));
  }
  const unknown = sparkSettings(JACOBIAN);
  assert.ok(!drawSparkBySpec(unknown, TRAINED, mesh));
  assert.equal(unknown.material.vertexShader, JACOBIAN);
});

const SHADERS = new Map([
  ["gsplatPS", "normExp(A) * gaussianColor.a if (A > 1.0)"],
  ["gsplatCommonVS", "float clip = min(1.0, sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5);"],
  ["gsplatCenterVS", "if (camera_params.w != 1.0 && centerView.z > 0.0) return false;"],
  [
    "gsplatCornerVS",
    "a + 0.3; b + 0.3; vec2 J2 = -J1 / vp.z * vp.xy; min(1024.0, min(viewport_size.x, viewport_size.y))",
  ],
]);

/** An application of PlayCanvas that has shaders, and what was made of it. */
function playCanvas(own: Map<string, string>, isWebGPU = false) {
  const edited = new Map<string, string>();
  const uniforms: Record<string, unknown> = {};
  const draws = new Set<(camera: { viewMatrix: { data: number[] } }) => void>();
  const material = { updates: 0, getShaderChunks: () => edited, update: () => void material.updates++ };
  const gsplat = { minPixelSize: 2, antiAlias: true, dataFormat: "compact", material };
  const app = {
    graphicsDevice: {
      isWebGPU,
      scope: { resolve: (name: string) => ({ setValue: (value: unknown) => (uniforms[name] = value) }) },
    },
    scene: {
      gsplat,
      on(_name: string, draw: (camera: { viewMatrix: { data: number[] } }) => void) {
        draws.add(draw);
        return { off: () => draws.delete(draw) };
      },
    },
  };
  const drawBySpec = (scene: typeof KERNEL, model = MOVED): boolean =>
    drawPlayCanvasBySpec({ ShaderChunks: { get: () => own } }, app, scene, {
      getWorldTransform: () => ({ data: model }),
    });
  const drawPicture = (): void => {
    for (const draw of draws) draw({ viewMatrix: { data: VIEW } });
  };
  return { drawBySpec, drawPicture, edited, uniforms, gsplat, draws };
}

/** Draw a scene by the specification in a PlayCanvas that has shaders. */
function drawInPlayCanvas(own: Map<string, string>, scene: typeof KERNEL, isWebGPU = false) {
  const { drawBySpec, drawPicture, edited, uniforms, gsplat } = playCanvas(own, isWebGPU);
  const isKnown = drawBySpec(scene);
  drawPicture();
  assert.deepEqual([gsplat.minPixelSize, gsplat.dataFormat], [0, "large"]);
  return { isKnown, edited, uniforms, antiAlias: gsplat.antiAlias };
}

test("playcanvas: shaders that are known are edited together or not at all", () => {
  const { isKnown, edited, antiAlias, uniforms } = drawInPlayCanvas(SHADERS, KERNEL);
  assert.ok(isKnown && !antiAlias);
  assert.deepEqual([...edited.keys()], [...SHADERS.keys()]);
  assert.match(edited.get("gsplatCenterVS")!, /centerView\.z > -camera_params\.z/);
  assert.match(edited.get("gsplatCornerVS")!, /^a \+ 1\.2; b \+ 1\.2; .*clamp\(/);
  assert.deepEqual(uniforms, {});
  const other = drawInPlayCanvas(new Map([...SHADERS, ["gsplatPS", "another"]]), KERNEL);
  assert.deepEqual(other, { isKnown: false, edited: new Map(), antiAlias: false, uniforms: {} });
  const { edited: none, isKnown: changed } = drawInPlayCanvas(SHADERS, KERNEL, true);
  assert.deepEqual([changed, none], [false, new Map()], "WebGPU has shaders of its own");
});

const COVARIANCE = "uniform float minPixelSize; mat3 cov = transpose(T) * Vrk * T; ";
const SIZED_SHADERS = new Map([...SHADERS, ["gsplatCornerVS", COVARIANCE + SHADERS.get("gsplatCornerVS")!]]);

test("playcanvas: splats are as thick as trained where the shaders are known and the scene has viewpoints", () => {
  const { isKnown, edited, antiAlias, uniforms } = drawInPlayCanvas(SIZED_SHADERS, TRAINED);
  assert.ok(isKnown && antiAlias);
  assert.match(edited.get("gsplatCornerVS")!, /cov\[1\]\[1\] \+= 1\.2 \* share; a \+ blur; b \+ blur;/);
  assert.deepEqual(uniforms, { trainingPixel: SEEN, trainingRest: 0 });
  const other = drawInPlayCanvas(SHADERS, TRAINED);
  assert.deepEqual(other, { isKnown: false, edited: new Map(), antiAlias: false, uniforms: {} });
});

test("playcanvas: a later call replaces the shaders and the viewpoints of an earlier one", () => {
  const { drawBySpec, drawPicture, edited, uniforms, gsplat, draws } = playCanvas(SIZED_SHADERS);
  assert.ok(drawBySpec(TRAINED));
  const [sized, updates] = [edited.get("gsplatCornerVS")!, gsplat.material.updates];
  assert.equal(updates, 1, "or the engine keeps the shaders of its first picture");
  assert.ok(drawBySpec(TRAINED, TURNED));
  assert.deepEqual([draws.size, gsplat.material.updates], [1, 2]);
  drawPicture();
  assert.deepEqual(uniforms.trainingPixel, TURNED_SEEN);
  assert.ok(drawBySpec(KERNEL));
  assert.deepEqual([draws.size, gsplat.antiAlias], [0, false]);
  assert.ok(!edited.get("gsplatCornerVS")!.includes("trainingArea") && sized.includes("trainingArea"));
});

test("spark: a later call replaces the shader and the viewpoints of an earlier one", () => {
  const settings = sparkSettings(SPARK_SHADER);
  const drawPicture = () =>
    settings.onBeforeRender({} as never, {} as never, { matrixWorldInverse: { elements: VIEW } });
  assert.ok(drawSparkBySpec(settings, TRAINED, mesh));
  const { vertexShader } = settings.material;
  assert.ok(drawSparkBySpec(settings, TRAINED, { matrixWorld: { elements: TURNED } }));
  assert.equal(settings.material.vertexShader, vertexShader);
  drawPicture();
  assert.deepEqual(settings.material.uniforms.trainingPixel!.value, TURNED_SEEN);
  assert.equal(settings.cameras.length, 1);
  assert.ok(drawSparkBySpec(settings, KERNEL, { matrixWorld: { elements: STRETCHED } }));
  assert.ok(!settings.material.vertexShader.includes("trainingPixel"));
  drawPicture();
});

test("a scene that is stretched along one axis has no pixel of training, and the error says so", () => {
  const inPlayCanvas = playCanvas(SIZED_SHADERS);
  inPlayCanvas.drawBySpec(TRAINED, STRETCHED);
  const uneven = { name: "RangeError", message: /lengths 2, 1, 2,.* scale it alike/ };
  assert.throws(inPlayCanvas.drawPicture, uneven);
  const settings = sparkSettings(SPARK_SHADER);
  drawSparkBySpec(settings, TRAINED, { matrixWorld: { elements: STRETCHED } });
  const camera = { matrixWorldInverse: { elements: VIEW } };
  assert.throws(() => settings.onBeforeRender({} as never, {} as never, camera), uneven);
});
