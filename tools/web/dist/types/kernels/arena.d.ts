/** A block of memory from which a decoder takes what one chunk needs, and gives all of it back at once. */
export declare abstract class Arena {
    u8: Uint8Array;
    u32: Uint32Array;
    f32: Float32Array;
    private top;
    /**
     * @param bottom - First byte that may be reserved; above 0, because address 0 means "none".
     */
    constructor(buffer: ArrayBuffer, bottom: number);
    alloc(bytes: number): number;
    mark(): number;
    release(mark: number): void;
    /** Make the memory at least so long and return its buffer; what it holds stays. */
    protected abstract grow(bytes: number): ArrayBuffer;
    private view;
}
