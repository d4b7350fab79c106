import assert from "node:assert/strict";
import { test } from "node:test";
import { isClosed, setStates } from "../src/container/chunk_sets.js";
import type { Index } from "../src/container/scene_index.js";
import type { ViewTable } from "../src/container/view_table.js";
import { CogsplatError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { concatenate, type Splats } from "../src/scene/splats.js";
import { manifest, sha256, type ValidVector, vectorBytes } from "./vectors.js";

const kernels = await loadKernels();

for (const vector of manifest.valid) {
  test(`${vector.name} decodes to the stated bits`, async () => {
    const file = new SceneFile(vectorBytes("valid", vector.name), kernels());
    assert.deepEqual(Array.from(file.index.chunks.splats), vector.chunk_splats);
    assert.equal(hashOf(file.decode()), vector.arrays_sha256);
    if (vector.coarse_sha256) assert.equal(hashOf(file.decode(undefined, false)), vector.coarse_sha256);
    assert.deepEqual(
      file.scene.levels,
      (vector.levels ?? []).map(([scale, chunks]) => ({ chunks, scale })),
    );
    for (const [level, [, , hash]] of (vector.levels ?? []).entries()) {
      assert.equal(hashOf(file.decode(undefined, true, level)), hash, `level ${level}`);
    }
    checkExtras(file, vector);
    await file.verify();
  });

  test(`beginnings of ${vector.name} give the stated chunks`, () => {
    const bytes = vectorBytes("valid", vector.name);
    const whole = new SceneFile(bytes, kernels());
    for (const [number, [length, chunks, tails, refined]] of vector.prefixes.entries()) {
      const file = new SceneFile(bytes.slice(0, length), kernels(), { partial: true });
      assert.equal(file.prefixChunks, chunks, `chunks of the first ${length} bytes`);
      if (vector.drawn) {
        assert.equal(hashOf(file.decode()), vector.drawn[number], `what the first ${length} bytes draw`);
        continue;
      }
      for (let chunk = 0; chunk < chunks; chunk++) {
        const refine = refined.includes(chunk);
        const expected = whole.decodeChunk(chunk, undefined, refine);
        if (!tails.includes(chunk)) expected.shN.fill(0);
        assert.equal(hashOf(file.decodeChunk(chunk)), hashOf(expected), `chunk ${chunk} of ${length} bytes`);
      }
    }
  });
}

// A part may be cut: this file has another fault behind its cut.
const PART_CODES: Record<string, string> = { "order-cut-splats": "splat-count" };

for (const vector of manifest.invalid) {
  test(`${vector.name} is refused with ${vector.code}`, async () => {
    const bytes = vectorBytes("invalid", vector.name);
    const partial = () => new SceneFile(bytes, kernels(), { partial: true });
    const refused = refusal(vector.code);
    if (vector.stage === "open") {
      assert.throws(() => new SceneFile(bytes, kernels()), refused);
      if (vector.partial) partial();
      else assert.throws(partial, refusal(PART_CODES[vector.name] ?? vector.code));
      return;
    }
    const file = new SceneFile(bytes, kernels());
    if (vector.stage === "decode") {
      assert.throws(() => {
        file.decode();
        for (let chunk = 0; chunk < file.index.chunkCount; chunk++) file.attributes(chunk);
      }, refused);
    } else {
      // This decoder always checks what readers may leave to verifiers of Huffman streams (SPEC 6.3).
      if (vector.name.startsWith("zstd-huffman")) assert.throws(() => file.decode(), refused);
      else file.decode();
      await assert.rejects(file.verify(), refused);
    }
  });
}

function refusal(code: string): (error: unknown) => boolean {
  return (error) => {
    assert.ok(error instanceof CogsplatError, `${String(error)} is no CogsplatError`);
    assert.equal(error.code, code, error.message);
    return true;
  };
}

function hashOf(splats: Splats): string {
  return sha256(splats.means, splats.scales, splats.quats, splats.opacities, splats.sh0, splats.shN);
}

function checkDescription(file: SceneFile, vector: ValidVector): void {
  const found = file.description();
  assert.equal(found === undefined, vector.description === undefined);
  if (found === undefined) return;
  const { metresPerUnit, ...keys } = found;
  // The manifest has the keys of SPEC without those that are not there; a key of a later version is skipped.
  const { mood: _, ...expected }: Record<string, unknown> = { views: [], annotations: [], ...vector.description };
  assert.deepEqual(JSON.parse(JSON.stringify({ ...keys, metres_per_unit: metresPerUnit })), expected);
  for (const name of ["poster", "sky"] as const) {
    const picture = file.picture(name);
    assert.equal(picture && sha256(picture), vector.pictures?.[name]?.[3]);
  }
}

/** Return the rows of the pages on the way to an index. */
function pathOf({ page }: Index): number[] {
  return page === undefined ? [] : [...pathOf(page.listedBy), page.listedBy.pages.indexOf(page)];
}

function viewpointsOf(table: ViewTable): number[][][] {
  return Array.from({ length: table.views }, (_, view) => [
    Array.from(table.positions.subarray(3 * view, 3 * view + 3)),
    Array.from(table.shares.subarray(table.chunks * view, table.chunks * (view + 1))),
  ]);
}

function checkExtras(file: SceneFile, vector: ValidVector): void {
  const names = (vector.attributes ?? []).map(([name]) => name);
  for (const [chunk, hashes] of vector.attribute_chunks ?? []) {
    const attributes = file.attributes(chunk)!;
    assert.deepEqual(
      names.map((name) => sha256(attributes.get(name)!)),
      hashes,
    );
  }
  const withAttributes = new Set((vector.attribute_chunks ?? []).map(([chunk]) => chunk));
  for (let chunk = 0; chunk < file.index.chunkCount; chunk++) {
    assert.equal(file.attributes(chunk) !== undefined, withAttributes.has(chunk));
  }
  assert.deepEqual(file.cameras(), vector.cameras);
  const tables = file.index.indexes.flatMap((index) => {
    const table = file.viewTable(index);
    return table === undefined ? [] : [[pathOf(index), viewpointsOf(table)]];
  });
  assert.deepEqual(tables, vector.view_tables ?? []);
  checkDescription(file, vector);
  for (const [prefix, hash] of vector.compensated ?? []) {
    const drawn = Array.from({ length: prefix }, (_, chunk) => chunk).filter((chunk) =>
      file.index.isDrawn(chunk, prefix),
    );
    const chunks = drawn.map((chunk) => {
      const splats = file.decodeChunk(chunk);
      file.compensate(splats, chunk, prefix);
      return splats;
    });
    const { scales, opacities } = concatenate(chunks, vector.sh_degree);
    assert.equal(sha256(scales, opacities), hash, `${prefix} chunks, compensated`);
  }
  const { rows } = file.index;
  for (const [chunks, hash] of vector.compensated_sets ?? []) {
    assert.ok(isClosed(chunks, rows), `${chunks.join()} have their parents`);
    const states = setStates(chunks, rows, file.compensation.layerChunks);
    const parts = chunks.map((chunk, place) => {
      const splats = file.decodeChunk(chunk);
      file.compensate(splats, chunk, states[place]!);
      return splats;
    });
    const { scales, opacities } = concatenate(parts, vector.sh_degree);
    assert.equal(sha256(scales, opacities), hash, `chunks ${chunks.join()}, compensated`);
  }
}
