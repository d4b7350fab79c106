import type { Kernels } from "./kernels.js";
/** Makes kernels with a memory of their own. */
export type KernelsMaker = () => Kernels;
/**
 * The fastest kernels that this place allows: WebAssembly, or plain JavaScript where the browser has no vectors or
 * the page's content security policy forbids compiling. `Kernels.backend` says which it is.
 */
export declare function loadKernels(): Promise<KernelsMaker>;
