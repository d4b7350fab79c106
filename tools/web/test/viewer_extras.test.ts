import assert from "node:assert/strict";
import { test } from "node:test";
import { between, positionOf, translationOf } from "../src/viewer/flight.js";
import { formatLength } from "../src/viewer/measure.js";
import { pick } from "../src/viewer/pick.js";
import { writeShaderRows } from "../src/viewer/shader_rows.js";
import { projectionOf } from "../src/viewer/stage.js";

/** Return rows of splats: round ones of one scale, at means, with opacities in 1/255. */
function packed(splats: readonly { readonly mean: readonly number[]; readonly opacity: number }[], scale: number) {
  const code = Math.round(1 + ((Math.log(scale) + 12) * 254) / 21);
  const count = splats.length;
  const rows = { splats: new Uint32Array(4 * count), shapes: new Uint32Array(2 * count) };
  const words = splats.flatMap(({ opacity }) => [
    (opacity << 24) >>> 0,
    0,
    ((128 << 16) | (128 << 24)) >>> 0,
    code | (code << 8) | (code << 16),
  ]);
  const means = Float32Array.from(splats.flatMap(({ mean }) => mean));
  writeShaderRows({ count, words: Uint32Array.from(words), means }, rows, 0);
  return rows;
}

/** A wall of opaque splats at a depth. */
function wall(depth: number, opacity = 250) {
  return Array.from({ length: 441 }, (_, i) => ({
    mean: [0.1 * ((i % 21) - 10), 0.1 * (Math.floor(i / 21) - 10), depth],
    opacity,
  }));
}

const AHEAD = { origin: [0, 0, 0], direction: [0, 0, 1], pixel: 0.001 } as const;

test("a ray ends at the first wall, and passes a mist and what is behind it", () => {
  const rows = packed([...wall(8), ...wall(5), ...wall(2, 6), ...wall(-3)], 0.06);
  const found = pick(rows, 4 * 441, { ...AHEAD, origin: [0, 0, 0], direction: [0, 0, 1] });
  assert.ok(Math.abs(found! - 5) < 0.05, String(found));
});

test("a ray beside the scene hits nothing, nor do rows that are not drawn", () => {
  const rows = packed(wall(5), 0.06);
  const aside = Math.hypot(3, 5);
  const beside = { ...AHEAD, origin: [0, 0, 0] as [number, number, number] };
  assert.equal(pick(rows, 441, { ...beside, direction: [3 / aside, 0, 5 / aside] }), undefined);
  assert.equal(pick(rows, 10, { ...beside, direction: [0, 0, 1] }), undefined);
});

test("a pose between two looks at a target between theirs, from between their distances", () => {
  const from = { height: 2, fx: 2, fy: 2, rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], translation: [0, 0, 4] };
  const rotation = [0, 0, -1, 0, 1, 0, 1, 0, 0];
  const to = {
    height: 1,
    fx: 4,
    fy: 4,
    rotation,
    translation: translationOf(rotation, [-15, 0, 0]),
    target: [1, 0, 0],
  };
  const half = between({ ...from, target: [0, 0, 0] }, to, 0.5);
  assert.deepEqual(half.target, [0.5, 0, 0]);
  const position = positionOf(half);
  const far = Math.hypot(position[0] - 0.5, position[1], position[2]);
  assert.ok(Math.abs(far - 8) < 1e-9, String(far));
  // Half of a quarter turn: it looks along x and z alike.
  assert.ok(Math.abs(half.rotation[6]! - Math.SQRT1_2) < 1e-9 && Math.abs(half.rotation[8]! - Math.SQRT1_2) < 1e-9);
  assert.ok(Math.abs(half.fx / half.height - 2) < 1e-9);
  for (const [share, pose] of [
    [0, from],
    [1, to],
  ] as const) {
    const end = between({ ...from, target: [0, 0, 0] }, to, share);
    positionOf(pose).forEach((value, i) => {
      assert.ok(Math.abs(positionOf(end)[i]! - value) < 1e-9);
    });
  }
});

test("points of the scene are where the picture shows them", () => {
  const pose = { height: 100, fx: 80, fy: 80, rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], translation: [0, 0, 4] };
  const { place } = projectionOf(pose, 400, 200);
  assert.deepEqual(place([0, 0, 0]), [200, 100]);
  assert.deepEqual(place([1, -0.5, 0]), [240, 80]);
  assert.equal(place([0, 0, -5]), undefined);
});

test("lengths are in the unit of the description, else in scene units", () => {
  assert.equal(formatLength(1.23456, { metresPerUnit: undefined, unit: undefined }), "1.23 scene units");
  assert.equal(formatLength(2, { metresPerUnit: 0.25, unit: undefined }), "0.5 m");
  assert.equal(formatLength(2, { metresPerUnit: 0.3048, unit: "ft" }), "2 ft");
  assert.equal(formatLength(0.0123, { metresPerUnit: 1, unit: "mm" }), "12.3 mm");
});
