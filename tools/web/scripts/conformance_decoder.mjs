// This package behind the protocol of docs/conformance.md:
// cogsplat conformance run --decoder 'node scripts/conformance_decoder.mjs [wasm|javascript]'
import { readFileSync, writeFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { CogsplatError, JavascriptKernels, loadKernels, SceneFile } from "../dist/cogsplat.js";

const VERSION = "0.1.0";
const [mode = "wasm"] = process.argv.slice(2);
const makeKernels = mode === "javascript" ? () => new JavascriptKernels() : await loadKernels();

async function decode({ path, out, partial, refine, verify }) {
  const file = new SceneFile(new Uint8Array(readFileSync(path)), makeKernels(), { partial });
  if (verify) await file.verify();
  const { count, means, scales, quats, opacities, sh0, shN } = file.decode(undefined, refine);
  writeFileSync(out, Buffer.concat([means, scales, quats, opacities, sh0, shN].map((array) => new Uint8Array(array.buffer))));
  return { ok: true, splats: count };
}

for await (const line of createInterface({ input: process.stdin })) {
  const request = JSON.parse(line);
  let answer;
  if (request.op === "hello") {
    answer = { name: `cogsplat for the web (${mode})`, version: VERSION, level: "verifier" };
  } else {
    try {
      answer = await decode(request);
    } catch (error) {
      if (!(error instanceof CogsplatError)) throw error;
      answer = { ok: false, code: error.code };
    }
  }
  console.log(JSON.stringify(answer));
}
