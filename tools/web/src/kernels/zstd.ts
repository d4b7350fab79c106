// A decoder of one zstd frame in plain JavaScript, written from RFC 8878. It refuses every frame that does not end where
// its bits do, as the kernels in WebAssembly and libzstd refuse it; decoders made for pages let some of them pass.
import { bitsAt, constantTable, firstBit, fseTable, readFse, readHuffman, type Table } from "./zstd_tables.js";

const MAX_BLOCK = 131_072;

// Base value and extra bits of each code (RFC 8878, 3.1.1.3.2.1.1).
const LENGTH_BITS = [...new Array<number>(16).fill(0), 1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16];
const MATCH_BITS = [
  ...new Array<number>(32).fill(0), 1, 1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16,
];
const LENGTH_BASE = [
  0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 18, 20, 22, 24, 28, 32, 40, 48, 64, 128, 256, 512, 1024,
  2048, 4096, 8192, 16384, 32768, 65536,
];
const MATCH_BASE = [
  3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33,
  34, 35, 37, 39, 41, 43, 47, 51, 59, 67, 83, 99, 131, 259, 515, 1027, 2051, 4099, 8195, 16387, 32771, 65539,
];

/** A kind of table of sequences: its last code, most bits of a state, predefined distribution (RFC 8878, 3.1.1.3.2). */
interface TableKind {
  readonly maxSymbol: number;
  readonly maxLog: number;
  readonly predefined: Table;
}

const LENGTHS: TableKind = {
  maxSymbol: 35,
  maxLog: 9,
  predefined: fseTable(
    [4, 3, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 3, 2, 1, 1, 1, 1, 1, -1, -1, -1, -1], 6,
  ),
};
const OFFSETS: TableKind = {
  maxSymbol: 31,
  maxLog: 8,
  predefined: fseTable([1, 1, 1, 1, 1, 1, 2, 2, 2, ...new Array<number>(15).fill(1), -1, -1, -1, -1, -1], 5),
};
const MATCHES: TableKind = {
  maxSymbol: 52,
  maxLog: 9,
  predefined: fseTable(
    [1, 4, 3, 2, 2, 2, 2, 2, 2, ...new Array<number>(37).fill(1), -1, -1, -1, -1, -1, -1, -1], 6,
  ),
};

/**
 * Decompress a frame whose header and chain of blocks were checked (`checkFrame`).
 *
 * @param frame - All of the frame.
 * @param target - As many bytes as the frame states.
 * @returns False where the frame is damaged or gives another number of bytes.
 */
export function decompressFrame(frame: Uint8Array, target: Uint8Array): boolean {
  return new FrameDecoder(frame, target).run();
}

class FrameDecoder {
  private out = 0;
  // What blocks hand on: the tree and the tables that "repeat" names, and the last three offsets.
  private huffman: Table | undefined;
  private lengths: Table | undefined;
  private offsets: Table | undefined;
  private matches: Table | undefined;
  private readonly recent: [number, number, number] = [1, 4, 8];
  private literals: Uint8Array = new Uint8Array(0);

  constructor(
    private readonly frame: Uint8Array,
    private readonly target: Uint8Array,
  ) {}

  run(): boolean {
    const { frame, target } = this;
    const single = (frame[4]! & 0x20) !== 0;
    const flag = frame[4]! >> 6;
    let at = 5 + (single ? 0 : 1) + (flag === 0 ? (single ? 1 : 0) : 1 << flag);
    for (;;) {
      const header = bitsAt(frame, at, 0, 24);
      const size = header >> 3;
      const type = (header >> 1) & 3;
      at += 3;
      if (type === 2) {
        if (!this.block(at, at + size)) return false;
      } else {
        if (this.out + size > target.length) return false;
        if (type === 0) target.set(frame.subarray(at, at + size), this.out);
        else target.fill(frame[at]!, this.out, this.out + size);
        this.out += size;
      }
      at += type === 1 ? 1 : size;
      if ((header & 1) !== 0) return this.out === target.length && at === frame.length;
    }
  }

  /** Decompress one block; false where it is damaged. */
  private block(start: number, end: number): boolean {
    const { frame } = this;
    let at = this.readLiterals(start, end);
    if (at === 0 || at >= end) return false;
    let count = frame[at++]!;
    if (count === 255) {
      count = bitsAt(frame, at, 0, 16) + 0x7f00;
      at += 2;
    } else if (count >= 128) {
      count = ((count - 128) << 8) + frame[at++]!;
    }
    if (count === 0) return at === end && this.copyLiterals(0);
    if (at >= end) return false;
    const modes = frame[at++]!;
    if ((modes & 3) !== 0) return false;
    this.lengths = this.readTable(modes >> 6, at, end, LENGTHS, this.lengths);
    if (this.lengths === undefined) return false;
    if (modes >> 6 === 1 || modes >> 6 === 2) at += this.lengths.consumed;
    this.offsets = this.readTable((modes >> 4) & 3, at, end, OFFSETS, this.offsets);
    if (this.offsets === undefined) return false;
    if (((modes >> 4) & 3) === 1 || ((modes >> 4) & 3) === 2) at += this.offsets.consumed;
    this.matches = this.readTable((modes >> 2) & 3, at, end, MATCHES, this.matches);
    if (this.matches === undefined) return false;
    if (((modes >> 2) & 3) === 1 || ((modes >> 2) & 3) === 2) at += this.matches.consumed;
    return this.sequences(at, end, count, this.lengths, this.offsets, this.matches);
  }

  private readTable(mode: number, at: number, end: number, kind: TableKind, previous: Table | undefined): Table | undefined {
    if (mode === 0) return kind.predefined;
    if (mode === 3) return previous;
    if (mode === 2) return readFse(this.frame, at, end, kind.maxSymbol, kind.maxLog);
    return at < end && this.frame[at]! <= kind.maxSymbol ? constantTable(this.frame[at]!) : undefined;
  }

  /** Read the literals section (RFC 8878, 3.1.1.3.1); where it ends, or 0 where it is damaged. */
  private readLiterals(start: number, end: number): number {
    const { frame } = this;
    const type = frame[start]! & 3;
    const format = (frame[start]! >> 2) & 3;
    if (type < 2) {
      const [bytes, shift] = (format & 1) === 0 ? [1, 3] : format === 1 ? [2, 4] : [3, 4];
      const size = bitsAt(frame, start, shift!, 8 * bytes! - shift!);
      const at = start + bytes!;
      if (size > MAX_BLOCK || at + (type === 0 ? size : 1) > end) return 0;
      this.literals = type === 0 ? frame.subarray(at, at + size) : new Uint8Array(size).fill(frame[at]!);
      return at + (type === 0 ? size : 1);
    }
    const bits = format < 2 ? 10 : format === 2 ? 14 : 18;
    const size = bitsAt(frame, start, 4, bits);
    const stored = bitsAt(frame, start, 4 + bits, bits);
    let at = start + (format < 2 ? 3 : format === 2 ? 4 : 5);
    const sectionEnd = at + stored;
    if (size > MAX_BLOCK || sectionEnd > end) return 0;
    if (type === 2) {
      this.huffman = readHuffman(frame, at, sectionEnd);
      if (this.huffman === undefined) return 0;
      at += this.huffman.consumed;
    }
    if (this.huffman === undefined) return 0;
    this.literals = new Uint8Array(size);
    return this.readCodes(this.huffman, at, sectionEnd, format === 0) ? sectionEnd : 0;
  }

  /** Decode one Huffman stream, or four whose lengths stand before them. */
  private readCodes(table: Table, start: number, end: number, alone: boolean): boolean {
    const { literals, frame } = this;
    if (alone) return huffmanStream(frame, table, start, end, literals);
    const part = (literals.length + 3) >> 2;
    const starts = [start + 6];
    for (let i = 0; i < 3; i++) {
      const length = bitsAt(frame, start + 2 * i, 0, 16);
      if (length === 0) return false;
      starts.push(starts[i]! + length);
    }
    if (starts[3]! >= end || 3 * part > literals.length) return false;
    return starts.every((from, i) => {
      const to = i < 3 ? (i + 1) * part : literals.length;
      return huffmanStream(frame, table, from, starts[i + 1] ?? end, literals.subarray(i * part, to));
    });
  }

  /** Carry out the sequences of a block (RFC 8878, 3.1.1.4). */
  private sequences(start: number, end: number, count: number, lengths: Table, offsets: Table, matches: Table): boolean {
    const { frame, target, recent, literals } = this;
    let at = firstBit(frame, start, end);
    if (at < 0) return false;
    /** The next bits down; −1 where there are fewer, which `at` tells. */
    const take = (bits: number): number => {
      at -= bits;
      return at < 0 ? 0 : bitsAt(frame, start, at, bits);
    };
    let length = take(lengths.log);
    let offset = take(offsets.log);
    let match = take(matches.log);
    let literal = 0;
    for (let i = 0; i < count; i++) {
      const offsetCode = offsets.symbols[offset]!;
      const matchCode = matches.symbols[match]!;
      const lengthCode = lengths.symbols[length]!;
      const offsetValue = 2 ** offsetCode + take(offsetCode);
      const matchLength = MATCH_BASE[matchCode]! + take(MATCH_BITS[matchCode]!);
      const literalLength = LENGTH_BASE[lengthCode]! + take(LENGTH_BITS[lengthCode]!);
      if (i + 1 < count) {
        length = lengths.bases[length]! + take(lengths.bits[length]!);
        match = matches.bases[match]! + take(matches.bits[match]!);
        offset = offsets.bases[offset]! + take(offsets.bits[offset]!);
      }
      if (at < 0) return false;
      const distance = distanceOf(offsetValue, literalLength, recent);
      const { out } = this;
      const from = out + literalLength - distance;
      if (literal + literalLength > literals.length || out + literalLength + matchLength > target.length) return false;
      if (distance === 0 || from < 0) return false;
      target.set(literals.subarray(literal, literal + literalLength), out);
      literal += literalLength;
      this.out += literalLength;
      // Byte by byte, because a match may reach into what it writes.
      for (let j = 0; j < matchLength; j++) target[this.out + j] = target[from + j]!;
      this.out += matchLength;
    }
    return at === 0 && this.copyLiterals(literal);
  }

  /** Copy the literals from one on to the end. */
  private copyLiterals(from: number): boolean {
    const rest = this.literals.subarray(from);
    if (this.out + rest.length > this.target.length) return false;
    this.target.set(rest, this.out);
    this.out += rest.length;
    return true;
  }
}

/** Decode one Huffman stream, from its last bit to its first; false unless it ends with its first bit. */
function huffmanStream(bytes: Uint8Array, table: Table, start: number, end: number, target: Uint8Array): boolean {
  const { log, symbols, bits } = table;
  let at = firstBit(bytes, start, end);
  if (at < 0) return false;
  for (let i = 0; i < target.length; i++) {
    // Bits before the first one count as 0.
    const index = at >= log ? bitsAt(bytes, start, at - log, log) : bitsAt(bytes, start, 0, at) << (log - at);
    target[i] = symbols[index]!;
    at -= bits[index]!;
    if (at < 0) return false;
  }
  return at === 0;
}

/** How far back a match begins, by its value and the offsets before it (RFC 8878, 3.1.1.5). */
function distanceOf(value: number, literalLength: number, recent: [number, number, number]): number {
  if (value > 3) {
    recent.unshift(value - 3);
    recent.pop();
    return value - 3;
  }
  const which = value + (literalLength === 0 ? 1 : 0);
  if (which === 1) return recent[0];
  const distance = which === 4 ? recent[0] - 1 : recent[which - 1]!;
  recent.splice(which === 2 ? 1 : 2, 1);
  recent.unshift(distance);
  return distance;
}
