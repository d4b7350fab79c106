import assert from "node:assert/strict";
import { test } from "node:test";
import { PageBudget } from "../src/viewer/page_budget.js";

test("viewers share a budget: small scenes leave the rest to large ones", () => {
  const budget = new PageBudget(1000);
  const shares: { a?: number; b?: number; c?: number } = {};
  const viewers = { a: {}, b: {}, c: {} };
  const ask = (name: "a" | "b" | "c", splats: number): void =>
    budget.ask(viewers[name], splats, (share) => {
      shares[name] = share;
    });
  ask("a", Number.POSITIVE_INFINITY);
  assert.deepEqual({ ...shares }, { a: 1000 });
  ask("b", Number.POSITIVE_INFINITY);
  assert.deepEqual({ ...shares }, { a: 500, b: 500 });
  ask("a", 5000);
  ask("b", 100);
  assert.equal(shares.a, 900);
  ask("c", 2000);
  assert.deepEqual([shares.a, shares.c], [450, 450]);
  budget.leave(viewers.b);
  budget.leave(viewers.c);
  assert.equal(shares.a, 1000);
  budget.total = 300;
  assert.equal(shares.a, 300);
});

test("the shares that viewers use never exceed the budget", () => {
  for (let turn = 0; turn < 200; turn++) {
    const budget = new PageBudget(1000);
    const used = new Map<object, () => number>();
    for (let i = 0; i < 1 + (turn % 7); i++) {
      const wish = Math.floor(Math.abs(Math.sin(turn * 31 + i * 7)) * 900);
      const viewer = {};
      let share = 0;
      budget.ask(viewer, wish, (given) => {
        share = given;
      });
      used.set(viewer, () => Math.min(wish, share));
    }
    const sum = [...used.values()].reduce((total, value) => total + value(), 0);
    assert.ok(sum <= 1000, String(sum));
  }
});
