// Compiles assembly/ to WebAssembly and writes it into src/kernels/wasm_bytes.ts, so that the package needs neither a
// second request nor `connect-src` for it. Two digits a byte are longer than base64 and shorter when they are gzipped,
// because equal bytes stay equal.
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import asc from "assemblyscript/asc";

const WASM = "build/kernels.wasm";
const OPTIONS = ["-O3", "--converge", "--enable", "simd", "--runtime", "stub", "--noAssert"];

// Tests of files that are no longer there would run on.
rmSync("build", { recursive: true, force: true });
mkdirSync("build");
const { error, stderr } = await asc.main(["assembly/index.ts", ...OPTIONS, "-o", WASM]);
if (error) {
  console.error(stderr.toString());
  throw error;
}
const bytes = readFileSync(WASM);
writeFileSync(
  "src/kernels/wasm_bytes.ts",
  `// Made by scripts/build_kernels.mjs from assembly/: not to be edited.\nexport const WASM_DIGITS: string =\n  "${bytes.toString("hex")}";\n`,
);
console.log(`kernels: ${bytes.length} bytes`);
