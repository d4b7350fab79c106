/** Reads fields of packed bits, the lowest first (SPEC 6.5). */
export class BitReader {
  private bit = 0;

  /**
   * @param bytes - Memory that holds the bits.
   * @param start - Byte where they begin.
   */
  constructor(
    private readonly bytes: Uint8Array,
    private readonly start: number,
  ) {}

  /** The next 0 to 51 bits as a number, exact. */
  take(count: number): number {
    let value = 0;
    for (let got = 0; got < count; ) {
      const byte = this.bytes[this.start + (this.bit >>> 3)]!;
      const offset = this.bit & 7;
      const bits = Math.min(8 - offset, count - got);
      value += ((byte >>> offset) & ((1 << bits) - 1)) * 2 ** got;
      got += bits;
      this.bit += bits;
    }
    return value;
  }
}
