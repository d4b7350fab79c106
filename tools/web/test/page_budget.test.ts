import assert from "node:assert/strict";
import { test } from "node:test";
import { budgetOf } from "../src/viewer/device_budget.js";
import { PageBudget } from "../src/viewer/page_budget.js";

test("viewers share a budget by size: small scenes leave the rest to large ones", () => {
  const budget = new PageBudget(1200);
  const shares: Record<string, number> = {};
  const b = {};
  const viewers: Record<string, object> = { a: {}, b, c: {} };
  const ask = (name: string, splats: number, size = 1, isChosen = false): void =>
    budget.ask(viewers[name]!, { splats, size, isChosen }, (share) => {
      shares[name] = share;
    });
  const shareOf = (name: string): number | undefined => shares[name];
  ask("a", Number.POSITIVE_INFINITY);
  assert.deepEqual({ ...shares }, { a: 1200 });
  ask("b", Number.POSITIVE_INFINITY, 2);
  assert.deepEqual({ ...shares }, { a: 400, b: 800 });
  ask("b", 100, 2);
  assert.equal(shareOf("a"), 1100);
  ask("c", 2000);
  assert.deepEqual([shareOf("a"), shareOf("c")], [550, 550]);
  // Out of sight a viewer has what the others leave.
  ask("c", 2000, 0);
  assert.deepEqual([shareOf("a"), shareOf("c")], [1100, 0]);
  ask("a", 300);
  assert.equal(shareOf("c"), 800);
  // A number that the page has chosen is kept.
  ask("b", 700, 2, true);
  assert.deepEqual({ ...shares }, { a: 500, b: Number.POSITIVE_INFINITY, c: 200 });
  budget.leave(b);
  budget.total = 400;
  assert.deepEqual([shareOf("a"), shareOf("c")], [400, 100]);
});

test("the shares that viewers use never exceed the budget", () => {
  for (let turn = 0; turn < 200; turn++) {
    const budget = new PageBudget(1000);
    const used = new Map<object, () => number>();
    for (let i = 0; i < 1 + (turn % 7); i++) {
      const splats = Math.floor(Math.abs(Math.sin(turn * 31 + i * 7)) * 900);
      const viewer = {};
      let share = 0;
      budget.ask(viewer, { splats, size: (turn * i) % 5, isChosen: false }, (given) => {
        share = given;
      });
      used.set(viewer, () => Math.min(splats, share));
    }
    const sum = [...used.values()].reduce((total, value) => total + value(), 0);
    assert.ok(sum <= 1000, String(sum));
  }
});

const COMPUTER = { userAgent: "Chrome/140", memoryGib: 8, isTouch: false, screenPx: 1080, graphics: "" };
const TOUCH = { userAgent: "Safari/605", memoryGib: undefined, isTouch: true, screenPx: 390, graphics: "Apple GPU" };

test("the default budget follows headset, phone, tablet, laptop and desktop", () => {
  const budgets = [
    { ...TOUCH, userAgent: "Mozilla/5.0 (X11; Linux x86_64; Quest 3) OculusBrowser/33", screenPx: 1000 },
    { ...TOUCH, memoryGib: 2 },
    TOUCH,
    { ...TOUCH, screenPx: 820 },
    { ...COMPUTER, graphics: "ANGLE (Intel, Intel(R) Iris(R) Xe Graphics Direct3D11)" },
    { ...COMPUTER, graphics: "ANGLE (AMD, AMD Radeon(TM) 780M Graphics, OpenGL 4.6)" },
    { ...COMPUTER, memoryGib: undefined, graphics: "Apple GPU" },
    { ...COMPUTER, memoryGib: 1, graphics: "Intel" },
    { ...COMPUTER, graphics: "ANGLE (AMD, AMD Radeon RX 6800 XT Direct3D11)" },
    { ...COMPUTER, graphics: "ANGLE (NVIDIA, NVIDIA GeForce RTX 4070)" },
  ].map(budgetOf);
  const millions = [0.5, 0.5, 1, 1.5, 2.5, 2.5, 2.5, 1.5, 12, 12];
  assert.deepEqual(
    budgets,
    millions.map((value) => 1e6 * value),
  );
});

test("the graphics change the default, and no budget that the page has chosen", () => {
  const ofDevice = new PageBudget();
  const before = ofDevice.total;
  let share = 0;
  ofDevice.ask({}, { splats: Number.POSITIVE_INFINITY, size: 1, isChosen: false }, (given) => {
    share = given;
  });
  ofDevice.adapt("Intel");
  assert.ok(before > ofDevice.total);
  assert.deepEqual([ofDevice.total, share], [2_500_000, 2_500_000]);
  const chosen = new PageBudget(9_000_000);
  chosen.adapt("Intel");
  assert.equal(chosen.total, 9_000_000);
});
