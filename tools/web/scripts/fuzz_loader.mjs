// Runs the loader against scripted hostile servers: node scripts/fuzz_loader.mjs --seconds 1200 --seed 7
// Prints each case in which the loader breaks a promise, as JSON for test/loader_cases.json.
import { parseArgs } from "node:util";
import { makeCase, runCase } from "../build/test/loader_cases.js";

const { values } = parseArgs({
  options: {
    seconds: { type: "string", default: "60" },
    seed: { type: "string", default: "1" },
  },
});
const first = Number(values.seed);
const end = Date.now() + 1000 * Number(values.seconds);
let rejection;
process.on("unhandledRejection", (error) => {
  rejection = error;
});
const ends = new Map();
let seed = first;
let findings = 0;
let slowest = [0, 0];
for (; Date.now() < end; seed++) {
  const start = performance.now();
  try {
    const { end: how } = await runCase(makeCase(seed), seed);
    ends.set(how, (ends.get(how) ?? 0) + 1);
    if (rejection !== undefined) throw new Error(`an unhandled rejection: ${rejection}`);
  } catch (error) {
    findings++;
    rejection = undefined;
    console.log(`seed ${seed}: ${error?.message ?? error}\n${JSON.stringify(makeCase(seed))}`);
    if (!(error instanceof Error) || process.env.STACK) console.log(error?.stack);
  }
  const passed = performance.now() - start;
  if (passed > slowest[0]) slowest = [passed, seed];
}
console.log(`${seed - first} cases, ${findings} findings, slowest ${Math.round(slowest[0])} ms (seed ${slowest[1]})`);
console.log(Object.fromEntries([...ends].sort(([, a], [, b]) => b - a)));
