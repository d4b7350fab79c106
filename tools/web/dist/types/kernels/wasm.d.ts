import type { Kernels } from "./kernels.js";
/** Compiles the module once, and makes a memory of its own for each scene. */
export declare class WasmModule {
    private readonly module;
    private constructor();
    /**
     * Compile the module.
     *
     * @throws WebAssembly.CompileError where there are no vectors of 128 bits, or a content security policy without
     *   `'wasm-unsafe-eval'` forbids it.
     */
    static compile(): Promise<WasmModule>;
    /** Kernels with a memory of their own. */
    kernels(): Kernels;
}
