import { Arena } from "./arena.js";
import type { Kernels } from "./kernels.js";
import { WASM_DIGITS } from "./wasm_bytes.js";

/** Functions of the module that are called as they are; flags are numbers there. */
type Functions = Omit<
  Kernels, "backend" | "u8" | "u32" | "f32" | "alloc" | "mark" | "release" | "floats"
> & {
  floats(planes: number, rows: number, infinite: number, target: number, stride: number): number;
};

interface Exports extends Functions {
  readonly memory: WebAssembly.Memory;
  readonly heapBase: WebAssembly.Global;
}

const PAGE_BYTES = 65_536;

/** Every function of SPEC 6 in WebAssembly, each handed on as it is. */
class WasmKernels extends Arena {
  readonly backend = "wasm";

  constructor(private readonly exports: Exports) {
    super(exports.memory.buffer as ArrayBuffer, exports.heapBase.value as number);
  }

  protected override grow(bytes: number): ArrayBuffer {
    const { memory } = this.exports;
    // Half as much again, so that a growing chunk does not copy its views at every step.
    const wanted = Math.ceil(Math.max(bytes, 1.5 * memory.buffer.byteLength) / PAGE_BYTES);
    memory.grow(wanted - memory.buffer.byteLength / PAGE_BYTES);
    return memory.buffer as ArrayBuffer;
  }
}

/** Compiles the module once, and makes a memory of its own for each scene. */
export class WasmModule {
  private constructor(private readonly module: WebAssembly.Module) {}

  /**
   * Compile the module.
   *
   * @throws WebAssembly.CompileError where there are no vectors of 128 bits, or a content security policy without
   *   `'wasm-unsafe-eval'` forbids it.
   */
  static async compile(): Promise<WasmModule> {
    const bytes = Uint8Array.from({ length: WASM_DIGITS.length / 2 }, (_, i) => parseInt(WASM_DIGITS.slice(2 * i, 2 * i + 2), 16));
    return new WasmModule(await WebAssembly.compile(bytes));
  }

  /** Kernels with a memory of their own. */
  kernels(): Kernels {
    const { exports } = new WebAssembly.Instance(this.module, {
      env: {
        abort(): never {
          throw new WebAssembly.RuntimeError("the kernels aborted");
        },
      },
    });
    const functions = exports as unknown as Exports;
    const { memory: _memory, heapBase: _heapBase, floats, ...others } = functions;
    return Object.assign(new WasmKernels(functions), others, {
      floats: (planes: number, rows: number, infinite: boolean, target: number, stride: number) =>
        floats(planes, rows, infinite ? 1 : 0, target, stride),
    });
  }
}
