import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { REASON_CODES } from "../src/errors.js";

test("reason codes and their classes are those of SPEC 12", () => {
  const spec = readFileSync(join(process.cwd(), "..", "..", "SPEC.md"), "utf8");
  const section = spec.slice(spec.indexOf("\n## 12 "), spec.indexOf("\n## Appendix A"));
  const rows = [...section.matchAll(/^\| `([a-z0-9-]+)` \| (\w+) \|/gm)].map(
    (match) => [match[1]!, match[2]!] as const,
  );
  assert.ok(rows.length > 50);
  assert.deepEqual(new Map([...REASON_CODES].sort()), new Map([...rows].sort() as never));
});
