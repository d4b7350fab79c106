import assert from "node:assert/strict";
import { test } from "node:test";
import { axesMatrix, axesRotation } from "../src/adapters/axes.js";
import { toGSplatElement } from "../src/adapters/playcanvas.js";
import { toPly } from "../src/adapters/ply.js";
import { streamToSpark, type SparkMesh, type SparkPackedSplats } from "../src/adapters/spark.js";
import { loadKernels } from "../src/kernels/load.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { SceneFile } from "../src/scene/scene_file.js";
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

test("PlayCanvas gets the same columns", () => {
  const splats = new SceneFile(vectorBytes("valid", "sh1"), kernels()).decode();
  const element = toGSplatElement(splats);
  const at = (name: string, row: number) => element.properties.find((property) => property.name === name)!.storage[row];
  assert.equal(element.count, splats.count);
  assert.equal(at("z", 5), splats.means[17]);
  assert.equal(at("f_rest_4", 5), splats.shN[9 * 5 + 4]); // second coefficient of green
  assert.equal(at("rot_3", 5), splats.quats[23]);
  assert.ok(element.properties.every(({ storage }) => storage.length === splats.count));
});

test("axes become matrices and rotations", () => {
  assert.deepEqual(axesMatrix("RDF"), [1, 0, 0, 0, -1, 0, 0, 0, -1]);
  assert.deepEqual(axesMatrix("RUB"), [1, 0, 0, 0, 1, 0, 0, 0, 1]);
  for (const axes of ["RDF", "RUB", "RFU", "LUF", "BRU", "DRB", "UBR"]) {
    const rotation = axesRotation(axes);
    const matrix = axesMatrix(axes);
    for (const vector of [[1, 0, 0], [0, 1, 0], [0, 0, 1]]) {
      const expected = [0, 1, 2].map((row) => vector.reduce((sum, v, i) => sum + matrix[3 * row + i]! * v, 0));
      rotate(rotation, vector).forEach((value, i) => assert.ok(Math.abs(value - expected[i]!) < 1e-12, axes));
    }
  }
  assert.throws(() => axesRotation("LDF"), RangeError);
});

test("Spark gets every row, every band, and one upload at the end", async () => {
  const bytes = vectorBytes("valid", "chunks");
  const scene = await StreamedScene.open(new Blob([new Uint8Array(bytes)]));
  const { PackedSplats, SplatMesh, made } = fakeSpark();
  const uploads: number[] = [];
  const { mesh, done } = streamToSpark(scene, { PackedSplats, SplatMesh }, { uploadInterval: 0, onUpload: (n) => uploads.push(n) });
  await done;
  const file = new SceneFile(bytes, kernels());
  let row = 0;
  for (let chunk = 0; chunk < file.index.chunkCount; chunk++) {
    const packed = file.decodePacked(chunk, undefined, { rgbMin: 0, rgbMax: 1, shRange: 1 });
    assert.deepEqual(made.words.subarray(4 * row, 4 * (row + packed.count)), packed.words);
    packed.sh.forEach((band, i) => {
      const width = band.length / packed.count;
      assert.deepEqual(made.bands[i]!.subarray(width * row, width * (row + packed.count)), band);
    });
    row += packed.count;
  }
  assert.equal(uploads.at(-1), scene.info.splats);
  assert.equal(mesh.numSplats, scene.info.splats);
  assert.ok(made.texture.needsUpdate);
});

function rotate([x, y, z, w]: readonly number[], v: readonly number[]): number[] {
  const cross = (a: readonly number[], b: readonly number[]) => [
    a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!,
  ];
  const q = [x!, y!, z!];
  const t = cross(q, v).map((value) => 2 * value);
  const u = cross(q, t);
  return v.map((value, i) => value + w! * t[i]! + u[i]!);
}

/** Classes with the members of Spark's that the adapter uses; the textures of bands exist from the beginning. */
function fakeSpark() {
  const made = { words: new Uint32Array(0), bands: [] as Uint32Array[], texture: { needsUpdate: false } };
  class PackedSplats implements SparkPackedSplats {
    numSplats = 0;
    needsUpdate = false;
    readonly extra = { sh1Texture: { value: made.texture } };
    ensureSplats(count: number): Uint32Array {
      return (made.words = new Uint32Array(4 * count));
    }
    ensureSplatsSh(level: number, count: number): Uint32Array {
      return (made.bands[level - 1] = new Uint32Array([2, 4, 4][level - 1]! * count));
    }
  }
  class SplatMesh implements SparkMesh {
    numSplats = 0;
    readonly quaternion = { set: () => undefined };
    updateVersion(): void {
      made.texture.needsUpdate &&= true;
    }
  }
  return { PackedSplats, SplatMesh, made };
}
