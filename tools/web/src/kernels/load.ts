import { JavascriptKernels } from "./javascript.js";
import type { Kernels } from "./kernels.js";
import { WasmModule } from "./wasm.js";

/** Makes kernels with a memory of their own. */
export type KernelsMaker = () => Kernels;

let maker: Promise<KernelsMaker> | undefined;

/**
 * The fastest kernels that this place allows: WebAssembly, or plain JavaScript where the browser has no vectors or
 * the page's content security policy forbids compiling. `Kernels.backend` says which it is.
 */
export function loadKernels(): Promise<KernelsMaker> {
  maker ??= compile();
  return maker;
}

async function compile(): Promise<KernelsMaker> {
  try {
    const module = await WasmModule.compile();
    return () => module.kernels();
  } catch (error) {
    if (!(error instanceof WebAssembly.CompileError) && !(error instanceof ReferenceError)) throw error;
    return () => new JavascriptKernels();
  }
}
