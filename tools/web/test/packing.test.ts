import assert from "node:assert/strict";
import { test } from "node:test";
import { loadKernels } from "../src/kernels/load.js";
import { fromHalf } from "../src/scene/half_floats.js";
import { DEFAULT_RANGES, shiftPacked, unpackSplats } from "../src/scene/packed_splats.js";
import { packBand as packPlyBand, packSplats as packPlySplats } from "../src/viewer/ply_packing.js";

const RANGES = DEFAULT_RANGES;
const SH_RANGE = 0.75;
const ROWS = 1003; // not a multiple of four
const SH_C0 = 0.28209479177387814;

/** Numbers from 0 to 1 that are the same in every run. */
function random(seed: number): () => number {
  let state = seed;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

/** Words, bits, first value and values of a row in each packed band. */
const BANDS = [
  [2, 7, 0, 9],
  [4, 8, 9, 15],
  [4, 6, 24, 21],
] as const;

interface Packer {
  splats(columns: readonly Float32Array[]): Uint32Array;
  bands(values: Float32Array, degree: number): Uint32Array[];
}

const k = (await loadKernels())();

/** The kernels, which pack what COGS files hold, and the code that packs PLY. */
const packers: Readonly<Record<string, Packer>> = {
  kernels: {
    splats(columns) {
      const table = k.alloc(64);
      const target = k.alloc(16 * ROWS);
      const addresses = columns.map(copied);
      k.u32.set(addresses, table >>> 2);
      k.packSplats(table, ROWS, RANGES.rgbMin, RANGES.rgbMax, target);
      return k.u32.slice(target >>> 2, (target >>> 2) + 4 * ROWS);
    },
    bands(values, degree) {
      const source = copied(values);
      const targets = BANDS.map(([words]) => k.alloc(4 * words * ROWS)) as [number, number, number];
      k.packShn(source, ROWS, degree, SH_RANGE, ...targets);
      return BANDS.slice(0, degree).map(([words], i) => {
        return k.u32.slice(targets[i]! >>> 2, (targets[i]! >>> 2) + words * ROWS);
      });
    },
  },
  "packing of PLY": {
    splats(columns) {
      const words = new Uint32Array(4 * ROWS);
      packPlySplats(columns, ROWS, RANGES.rgbMin, RANGES.rgbMax, words);
      return words;
    },
    bands(values, degree) {
      return BANDS.slice(0, degree).map(([words, bits, first, count]) => {
        const target = new Uint32Array(words * ROWS);
        packPlyBand(values, ROWS, values.length / ROWS, first, count, bits, SH_RANGE, words, target);
        return target;
      });
    },
  },
};

function copied(values: Float32Array): number {
  const address = k.alloc(4 * values.length);
  k.f32.set(values, address >>> 2);
  return address;
}

/** 14 columns of splats that renderers meet, with the ends of every range. */
function makeColumns(): Float32Array[] {
  const next = random(7);
  const values = Array.from({ length: 14 }, () => new Float32Array(ROWS));
  for (let row = 0; row < ROWS; row++) {
    const quat = [next() - 0.5, next() - 0.5, next() - 0.5, next() - 0.5].map((v) => (row === 0 ? 0 : v));
    if (row === 0) quat[0] = 1; // no rotation
    if (row === 1) quat.splice(0, 4, 0, 0, 0, -1); // half a turn about −z
    const norm = Math.hypot(...quat) * (quat[0]! < 0 ? -1 : 1);
    const logit = [Infinity, -Infinity, 40, -40, 0][row] ?? 12 * (next() - 0.5);
    const centre = row === 2 ? 1e-6 : row === 3 ? -1e-8 : 200 * (next() - 0.5);
    const splat = [
      centre,
      next() / 64,
      -next(),
      -12 + 21 * next(),
      -20,
      20,
      ...quat.map((v) => v / norm),
      logit,
      4 * (next() - 0.5),
      next(),
      -next(),
    ];
    splat.forEach((value, column) => {
      values[column]![row] = value;
    });
  }
  return values;
}

for (const [name, packer] of Object.entries(packers)) {
  test(`${name}: packed splats are within the tolerances of SPEC 8.6`, () => {
    const values = makeColumns();
    const words = packer.splats(values);
    const unpacked = unpackSplats({ count: ROWS, words, sh: [], ranges: RANGES });
    for (let row = 0; row < ROWS; row++) {
      const [w0, w1, w2, w3] = words.subarray(4 * row, 4 * row + 4) as unknown as [number, number, number, number];
      const at = (column: number) => values[column]![row]!;
      for (const [axis, bits] of [w1 & 0xffff, w1 >>> 16, w2 & 0xffff].entries()) {
        const bound = Math.max(2 ** -11 * Math.abs(at(axis)), 2 ** -25);
        assert.ok(
          Math.abs(fromHalf(bits) - at(axis)) <= bound,
          `mean ${row}.${axis}: ${fromHalf(bits)} for ${at(axis)}`,
        );
      }
      for (const axis of [0, 1, 2]) {
        const code = (w3 >>> (8 * axis)) & 255;
        const log = Math.min(Math.max(at(3 + axis), -12), 9);
        assert.ok(Math.abs(-12 + ((code - 1) * 21) / 254 - log) <= 0.05, `scale ${row}.${axis}`);
        // The range of 2 has steps of 1/127.5.
        const colour = Math.min(Math.max(at(11 + axis) * SH_C0 + 0.5, RANGES.rgbMin), RANGES.rgbMax);
        assert.ok(Math.abs(unpacked.sh0[3 * row + axis]! * SH_C0 + 0.5 - colour) <= 0.00393, `colour ${row}.${axis}`);
      }
      const opacity = 1 / (1 + Math.exp(-at(10)));
      assert.ok(Math.abs((w0 >>> 24) / 255 - opacity) <= 1 / 128, `opacity ${row}`);
      const dot = [0, 1, 2, 3].reduce((sum, i) => sum + unpacked.quats[4 * row + i]! * at(6 + i), 0);
      const angle = 2 * Math.acos(Math.min(Math.abs(dot), 1));
      assert.ok(angle <= 0.034, `rotation ${row}: ${angle} radians`);
    }
  });

  test(`${name}: shifts of compensation act on packed splats as on arrays`, () => {
    const values = makeColumns();
    const words = packer.splats(values);
    const shifts = { scales: new Float32Array(ROWS).fill(0.3), opacities: new Float32Array(ROWS).fill(1.25) };
    const shifted = new Uint32Array(4 + words.length);
    shiftPacked(words, shifts, shifted, 4);
    const before = unpackSplats({ count: ROWS, words, sh: [], ranges: RANGES });
    const after = unpackSplats({ count: ROWS, words: shifted.subarray(4), sh: [], ranges: RANGES });
    assert.deepEqual(after.means, before.means);
    assert.deepEqual(after.quats, before.quats);
    assert.deepEqual(after.sh0, before.sh0);
    for (let i = 0; i < ROWS; i++) {
      const scale = Math.min(Math.max(values[3]![i]! + 0.3, -12), 9);
      assert.ok(Math.abs(after.scales[3 * i]! - scale) <= 0.0831, `scale ${i}`);
      const alpha = (logit: number) => 1 / (1 + Math.exp(-logit));
      assert.ok(Math.abs(alpha(after.opacities[i]!) - alpha(values[10]![i]! + 1.25)) <= 0.009, `opacity ${i}`);
    }
  });

  for (const degree of [1, 2, 3]) {
    test(`${name}: packed SH of degree ${degree} has every coefficient within half a step`, () => {
      const floats = 3 * ((degree + 1) ** 2 - 1);
      const next = random(11);
      const values = Float32Array.from({ length: floats * ROWS }, () => 1.6 * (next() - 0.5));
      for (const [band, words] of packer.bands(values, degree).entries()) {
        const [width, bits, first, count] = BANDS[band]!;
        const most = 2 ** (bits - 1) - 1;
        for (let row = 0; row < ROWS; row++) {
          const packed = words.subarray(width * row, width * (row + 1));
          const all = packed.reduceRight((sum, word) => (sum << 32n) | BigInt(word), 0n);
          for (let i = 0; i < count; i++) {
            const code = Number(BigInt.asIntN(bits, all >> BigInt(bits * i)));
            const value = Math.min(Math.max(values[row * floats + first + i]!, -SH_RANGE), SH_RANGE);
            assert.ok(Math.abs((code * SH_RANGE) / most - value) <= 0.38 / most, `row ${row}, value ${first + i}`);
          }
          assert.equal(all >> BigInt(bits * count), 0n, "bits behind the last value");
        }
      }
    });
  }
}
