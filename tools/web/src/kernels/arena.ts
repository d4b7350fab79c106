/** Every reservation begins at a multiple of this, so that vectors of 16 bytes are aligned. */
const ALIGNMENT = 16;
/** Bytes behind each reservation that kernels may write when they store whole vectors. */
const PADDING = 32;
/** Bytes behind the last reservation that readers of packed bits may load, and never use. */
const SLACK = 64;

/** A block of memory from which a decoder takes what one chunk needs, and gives all of it back at once. */
export abstract class Arena {
  u8!: Uint8Array;
  u32!: Uint32Array;
  f32!: Float32Array;
  private top: number;

  /**
   * @param bottom - First byte that may be reserved; above 0, because address 0 means "none".
   */
  constructor(
    buffer: ArrayBuffer,
    bottom: number,
  ) {
    this.top = align(bottom);
    this.view(buffer);
  }

  alloc(bytes: number): number {
    const start = this.top;
    const end = align(start + bytes + PADDING);
    if (end + SLACK > this.u8.length) this.view(this.grow(end + SLACK));
    this.top = end;
    return start;
  }

  mark(): number {
    return this.top;
  }

  release(mark: number): void {
    this.top = mark;
  }

  /** Make the memory at least so long and return its buffer; what it holds stays. */
  protected abstract grow(bytes: number): ArrayBuffer;

  private view(buffer: ArrayBuffer): void {
    this.u8 = new Uint8Array(buffer);
    this.u32 = new Uint32Array(buffer);
    this.f32 = new Float32Array(buffer);
  }
}

function align(bytes: number): number {
  return Math.ceil(bytes / ALIGNMENT) * ALIGNMENT;
}
