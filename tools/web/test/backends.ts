import { JavascriptKernels } from "../src/kernels/javascript.js";
import type { Kernels } from "../src/kernels/kernels.js";
import { WasmModule } from "../src/kernels/wasm.js";

/** Every implementation of the kernels that this machine can run, each as a maker of fresh memory. */
export async function backends(): Promise<ReadonlyMap<string, () => Kernels>> {
  const module = await WasmModule.compile();
  return new Map<string, () => Kernels>([
    ["javascript", () => new JavascriptKernels()],
    ["wasm", () => module.kernels()],
  ]);
}
