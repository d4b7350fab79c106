/** Reads fields of packed bits, the lowest first (SPEC 6.5). */
export declare class BitReader {
    private readonly bytes;
    private readonly start;
    private bit;
    /**
     * @param bytes - Memory that holds the bits.
     * @param start - Byte where they begin.
     */
    constructor(bytes: Uint8Array, start: number);
    /** The next 0 to 51 bits as a number, exact. */
    take(count: number): number;
}
