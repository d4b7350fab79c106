import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import type { SceneRows } from "../src/container/scene_rows.js";
import type { ViewTable } from "../src/container/view_table.js";
import {
  byBoxes,
  bySgss,
  byViewTable,
  effectiveSplats,
  type PoseRatios,
  sumAlongPath,
} from "../src/schedule/chunk_ratios.js";
import { childrenOf, growth } from "../src/schedule/growth.js";
import { type Pose, predictPath } from "../src/schedule/poses.js";
import { Scheduler } from "../src/schedule/scheduler.js";
import type { Unit } from "../src/schedule/unit_links.js";

/** Contents of the file of `tools/lab/make_decisions.py`. */
interface Scene {
  readonly boxes: readonly (readonly number[])[];
  readonly contribution: readonly number[];
  readonly splats: readonly number[];
  readonly units: readonly (readonly [number, number, number, number, readonly number[]])[];
  readonly positions: readonly (readonly number[])[];
  readonly codes: readonly (readonly number[])[];
}
interface State {
  readonly scene: number;
  readonly rule: "views" | "boxes" | "sgss";
  readonly now: readonly number[];
  readonly before: readonly number[];
  readonly elapsed: number;
  readonly there: readonly number[];
  readonly under_way: readonly number[];
  readonly received: readonly (readonly [number, number])[];
  readonly budget_splats: number;
  readonly bytes_per_second: number;
  readonly latency: number;
  readonly evicted: readonly (readonly [number, number])[];
  readonly decision: readonly (readonly number[])[];
  readonly worths: readonly number[];
}

interface Tree {
  readonly held: readonly number[];
  readonly parents: readonly number[];
  readonly splats: readonly number[];
  readonly missing: readonly number[];
  readonly boxes: readonly (readonly number[])[];
  readonly means: readonly (readonly number[])[];
  readonly growth: readonly number[];
}

const FILE = join(process.cwd(), "..", "..", "tests", "tools", "lab", "scheduling", "decisions.json");
const { scenes, states, trees } = JSON.parse(readFileSync(FILE, "utf8")) as {
  scenes: readonly Scene[];
  states: readonly State[];
  trees: readonly Tree[];
};

function poseOf(numbers: readonly number[]): Pose {
  return { position: numbers.slice(0, 3), rotation: numbers.slice(3, 12), tanX: numbers[12]!, tanY: numbers[13]! };
}

function tableOf({ positions, codes, splats }: Scene): ViewTable {
  const share = (code: number): number => (code === 0 ? 0 : (2 + (code & 1)) * 2 ** ((code >> 1) - 128));
  return {
    views: positions.length,
    chunks: splats.length,
    positions: Float32Array.from(positions.flat()),
    shares: Float64Array.from(codes.flat(), share),
  };
}

function ratiosOf(scene: Scene, rule: State["rule"]): PoseRatios {
  const boxes = Float64Array.from(scene.boxes.flat());
  const contribution = Float64Array.from(scene.contribution);
  if (rule === "sgss") return bySgss(boxes, scene.splats);
  return rule === "boxes" ? byBoxes(boxes, contribution) : byViewTable(tableOf(scene), boxes, contribution);
}

test("the scheduler decides as the reference does in every state", () => {
  assert.ok(states.length >= 1000);
  for (const [number, state] of states.entries()) {
    const scene = scenes[state.scene]!;
    const units: Unit[] = scene.units.map(([row, isHead, gain, size, after]) => ({
      row,
      isHead: isHead === 1,
      gain,
      size,
      dependencies: after,
    }));
    const ratios = sumAlongPath(
      ratiosOf(scene, state.rule),
      predictPath(poseOf(state.now), poseOf(state.before), state.elapsed),
    );
    const { stop, evict, fetch } = new Scheduler(units, scene.splats, scene.contribution).decide(ratios, {
      arrived: new Set(state.there),
      inFlight: new Set(state.under_way),
      received: new Map(state.received),
      budgetSplats: state.budget_splats,
      evictedWorths: new Map(state.evicted),
      bytesPerSecond: state.bytes_per_second,
      latency: state.latency,
    });
    assert.deepEqual([stop, [...evict.keys()], fetch], state.decision, `state ${number}`);
    assert.deepEqual([...evict.values()], state.worths, `state ${number}`);
  }
});

test("chunks count by what a pose shows of them, and never for more than they have", () => {
  const ratios = Float64Array.of(2, 0.5, 1 / 512, 1 / 512);
  assert.deepEqual(effectiveSplats([8192, 1000, 100, 1], ratios), [8192, 250, 0, 0]);
});

test("splats grow as in the reference for what is missing below them", () => {
  assert.ok(trees.length >= 30 && trees.some((tree) => tree.growth.some((added) => added > 0)));
  for (const [number, { held, parents, splats, missing, boxes, means, growth: expected }] of trees.entries()) {
    const below = parents.flatMap((parent, row) => (parent === 0 ? [row] : []));
    const rows = {
      count: parents.length,
      parents,
      chunks: parents.map((_, row) => row),
      inFileOrder: () => parents.keys(),
      rowOf: (chunk: number) => chunk,
      boxOf: (row: number) => Float32Array.from(boxes[below.indexOf(row)] ?? [0, 0, 0, 0, 0, 0]),
    } as unknown as SceneRows;
    const children = childrenOf(held, rows, splats).get(0);
    const wanted = below.map((row) => missing[row]);
    assert.deepEqual(children?.map((child) => child.missing) ?? below.map(() => 0), wanted, `tree ${number}`);
    const found = growth(Float32Array.from(means.flat()), children ?? []);
    assert.deepEqual([...found], expected, `tree ${number}`);
  }
});
