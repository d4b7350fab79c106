/** A table of states or of codes, and how many bits of the frame describe it. */
export interface Table {
    /** Bits of a state, or of the longest code. */
    readonly log: number;
    readonly symbols: Uint8Array;
    /** Bits that a state takes to the next, or of a code. */
    readonly bits: Uint8Array;
    /** State that those bits are added to; empty for codes. */
    readonly bases: Uint16Array;
    /** Bytes of the frame that were read. */
    readonly consumed: number;
}
/** Bits of a string that is read from its last byte to its first. */
export declare function bitsAt(bytes: Uint8Array, start: number, at: number, count: number): number;
/** Where a string of bits begins that ends with a set bit at `end`; −1 where its last byte is 0 or it is empty. */
export declare function firstBit(bytes: Uint8Array, start: number, end: number): number;
/** Read a distribution and build its table (RFC 8878, 4.1.1); undefined where it is damaged. */
export declare function readFse(bytes: Uint8Array, start: number, end: number, maxSymbol: number, maxLog: number): Table | undefined;
/** Spread the symbols of a distribution over the states (RFC 8878, 4.1.1). */
export declare function fseTable(probabilities: readonly number[], log: number, consumed?: number): Table;
/** A table of one state that always gives the same symbol. */
export declare function constantTable(symbol: number): Table;
/** Read a Huffman tree (RFC 8878, 4.2.1); undefined where it is damaged. */
export declare function readHuffman(bytes: Uint8Array, start: number, end: number): Table | undefined;
