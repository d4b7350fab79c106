import type { Kernels } from "./kernels.js";
import { WASM_DIGITS } from "./wasm_bytes.js";

/** Exports of the module: the arithmetic of `Kernels`, with flags as numbers. */
type Functions = Omit<Kernels, "u8" | "u32" | "f32" | "alloc" | "mark" | "release" | "floats"> & {
  floats(planes: number, rows: number, infinite: number, target: number, stride: number): number;
};

interface Exports extends Functions {
  readonly memory: WebAssembly.Memory;
  readonly heapBase: WebAssembly.Global;
}

const PAGE_BYTES = 65_536;
/** Every reservation begins at a multiple of this, bytes, so that vectors of 16 bytes are aligned. */
const ALIGNMENT = 16;
/** Bytes behind each reservation that kernels may overwrite when they store whole vectors. */
const PADDING = 32;
/** Bytes behind the last reservation that readers of packed bits may load and never use. */
const SLACK = 64;

/** WebAssembly memory with a stack of reservations; a decoder releases all buffers of a chunk at once. */
class KernelMemory {
  u8!: Uint8Array;
  u32!: Uint32Array;
  f32!: Float32Array;
  private top: number;

  /** @param bottom - First byte that may be reserved; above 0, because address 0 means "none". */
  constructor(
    private readonly memory: WebAssembly.Memory,
    bottom: number,
  ) {
    this.top = align(bottom);
    this.view();
  }

  alloc(bytes: number): number {
    const start = this.top;
    const end = align(start + bytes + PADDING);
    if (end + SLACK > this.u8.length) this.grow(end + SLACK);
    this.top = end;
    return start;
  }

  mark(): number {
    return this.top;
  }

  release(mark: number): void {
    this.top = mark;
  }

  private grow(bytes: number): void {
    const { memory } = this;
    // Growth by half bounds the number of times that the views are made again.
    const wanted = Math.ceil(Math.max(bytes, 1.5 * memory.buffer.byteLength) / PAGE_BYTES);
    memory.grow(wanted - memory.buffer.byteLength / PAGE_BYTES);
    this.view();
  }

  private view(): void {
    const { buffer } = this.memory;
    this.u8 = new Uint8Array(buffer);
    this.u32 = new Uint32Array(buffer);
    this.f32 = new Float32Array(buffer);
  }
}

function align(bytes: number): number {
  return Math.ceil(bytes / ALIGNMENT) * ALIGNMENT;
}

/** Makes kernels with a memory of their own. */
export type KernelsMaker = () => Kernels;

let maker: Promise<KernelsMaker> | undefined;

/**
 * Compile the WebAssembly kernels, once for all callers.
 *
 * @throws Error where the browser or the page's Content-Security-Policy does not allow it; the message says which.
 */
export function loadKernels(): Promise<KernelsMaker> {
  maker ??= compile();
  return maker;
}

async function compile(): Promise<KernelsMaker> {
  const bytes = Uint8Array.from({ length: WASM_DIGITS.length / 2 }, (_, i) =>
    parseInt(WASM_DIGITS.slice(2 * i, 2 * i + 2), 16),
  );
  try {
    const module = await WebAssembly.compile(bytes);
    return () => makeKernels(module);
  } catch (error) {
    throw new Error(reasonNotCompiled(bytes), { cause: error });
  }
}

function makeKernels(module: WebAssembly.Module): Kernels {
  const { exports } = new WebAssembly.Instance(module, {
    env: {
      abort(): never {
        throw new WebAssembly.RuntimeError("the kernels aborted");
      },
    },
  });
  const { memory, heapBase, floats, ...others } = exports as unknown as Exports;
  return Object.assign(new KernelMemory(memory, heapBase.value as number), others, {
    floats: (planes: number, rows: number, infinite: boolean, target: number, stride: number) =>
      floats(planes, rows, infinite ? 1 : 0, target, stride),
  });
}

/** Return why the module was not compiled: `validate` needs no permission of the page. */
function reasonNotCompiled(bytes: BufferSource): string {
  if (typeof WebAssembly === "undefined") return "COGS needs WebAssembly, which this browser does not have";
  if (!WebAssembly.validate(bytes)) {
    return "COGS needs WebAssembly with 128-bit vectors: Chrome 91, Firefox 89, Safari 16.4, Node 20 or later";
  }
  return (
    "COGS needs WebAssembly, which the Content-Security-Policy of this page or worker forbids: " +
    "add 'wasm-unsafe-eval' to its script-src directive"
  );
}
