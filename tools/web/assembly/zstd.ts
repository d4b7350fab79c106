// A decoder of one zstd frame, written from RFC 8878. The caller has checked the frame header and the chain of blocks
// (src/streams/zstd_frame.ts): no dictionary, no checksum, blocks that end where the frame does.

import { constant, consumed, huffmanTable, predefined, readFse, readHuffman, tableLog } from "./zstd_tables";

const MAX_BLOCK: i32 = 131072;

const literals = memory.data(131072 + 32);
const lengthTable = memory.data(512 * 4);
const offsetTable = memory.data(256 * 4);
const matchTable = memory.data(512 * 4);

// Base value and extra bits of each code (RFC 8878, 3.1.1.3.2.1.1).
const LENGTH_BASE = memory.data<u32>([
  0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 18, 20, 22, 24, 28, 32, 40, 48, 64, 128, 256, 512, 1024,
  2048, 4096, 8192, 16384, 32768, 65536,
]);
const LENGTH_BITS = memory.data<u8>([
  0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16,
]);
const MATCH_BASE = memory.data<u32>([
  3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33,
  34, 35, 37, 39, 41, 43, 47, 51, 59, 67, 83, 99, 131, 259, 515, 1027, 2051, 4099, 8195, 16387, 32771, 65539,
]);
const MATCH_BITS = memory.data<u8>([
  0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 3,
  3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16,
]);

// What blocks of one frame hand on: the trees and tables that "repeat" names, and the last three offsets.
let huffmanLog: i32 = 0;
let lengthLog: i32 = -1;
let offsetLog: i32 = -1;
let matchLog: i32 = -1;
let rep0: u32 = 1;
let rep1: u32 = 4;
let rep2: u32 = 8;

// What a literals section gives.
let literalStart: usize = 0;
let literalCount: i32 = 0;

/** Decompress a frame of exactly `length` bytes; −1 where it is damaged or gives another number of bytes. */
export function zstd(source: usize, sourceLength: i32, target: usize, length: i32): i32 {
  const descriptor = load<u8>(source + 4);
  const single = (descriptor & 0x20) !== 0;
  const flag = descriptor >> 6;
  const sizeBytes = flag === 0 ? (single ? 1 : 0) : 1 << flag;
  let at = source + 5 + (single ? 0 : 1) + sizeBytes;
  let out = target;
  const end = target + length;
  huffmanLog = 0;
  lengthLog = -1;
  offsetLog = -1;
  matchLog = -1;
  rep0 = 1;
  rep1 = 4;
  rep2 = 8;
  while (true) {
    const header = load<u32>(at) & 0xffffff;
    const size = <i32>(header >> 3);
    const type = (header >> 1) & 3;
    at += 3;
    if (type === 2) {
      const next = block(at, size, target, out, end);
      if (next === 0) return -1;
      out = next;
    } else {
      if (out + size > end) return -1;
      if (type === 0) memory.copy(out, at, size);
      else memory.fill(out, load<u8>(at), size);
      out += size;
    }
    at += type === 1 ? 1 : size;
    if (header & 1) break;
  }
  return out === end && at === source + sourceLength ? 0 : -1;
}

/** Decompress one block; where its bytes end, or 0 where it is damaged. */
function block(source: usize, size: i32, frame: usize, out: usize, end: usize): usize {
  const blockEnd = source + size;
  let at = readLiterals(source, blockEnd);
  if (at === 0 || at >= blockEnd) return 0;
  let count = <i32>load<u8>(at++);
  if (count >= 128) {
    if (count < 255) {
      count = ((count - 128) << 8) + load<u8>(at++);
    } else {
      count = <i32>load<u16>(at) + 0x7f00;
      at += 2;
    }
  }
  if (count === 0) {
    if (at !== blockEnd || out + literalCount > end) return 0;
    memory.copy(out, literalStart, literalCount);
    return out + literalCount;
  }
  if (at >= blockEnd) return 0;
  const modes = load<u8>(at++);
  if ((modes & 3) !== 0) return 0;
  lengthLog = readTable(modes >> 6, at, blockEnd, lengthTable, 0, lengthLog);
  if (lengthLog < 0) return 0;
  offsetLog = readTable((modes >> 4) & 3, at + consumedBytes, blockEnd, offsetTable, 1, offsetLog);
  if (offsetLog < 0) return 0;
  matchLog = readTable((modes >> 2) & 3, at + consumedBytes, blockEnd, matchTable, 2, matchLog);
  if (matchLog < 0) return 0;
  return sequences(at + consumedBytes, blockEnd, count, frame, out, end);
}

/** Bytes that the tables of this block have taken so far. */
let consumedBytes: usize = 0;

/** Read one of the three tables; the bits of its states, or −1. */
function readTable(mode: u32, at: usize, end: usize, table: usize, which: i32, previous: i32): i32 {
  if (which === 0) consumedBytes = 0;
  if (mode === 0) return predefined(which, table);
  if (mode === 3) return previous;
  const maxSymbol = which === 0 ? 35 : which === 1 ? 31 : 52;
  if (mode === 1) {
    if (at >= end) return -1;
    const symbol = load<u8>(at);
    if (symbol > <u8>maxSymbol) return -1;
    constant(table, symbol);
    consumedBytes += 1;
    return 0;
  }
  if (!readFse(at, end, table, maxSymbol, which === 1 ? 8 : 9)) return -1;
  consumedBytes += consumed;
  return tableLog;
}

/** Read the literals section (RFC 8878, 3.1.1.3.1); where it ends, or 0 where it is damaged. */
function readLiterals(source: usize, end: usize): usize {
  const first = <u32>load<u8>(source);
  const type = first & 3;
  const format = (first >> 2) & 3;
  if (type < 2) {
    let size: i32;
    let at = source;
    if ((format & 1) === 0) {
      size = first >> 3;
      at += 1;
    } else if (format === 1) {
      size = load<u16>(source) >> 4;
      at += 2;
    } else {
      size = (load<u32>(source) & 0xffffff) >> 4;
      at += 3;
    }
    if (size > MAX_BLOCK) return 0;
    literalCount = size;
    if (type === 0) {
      literalStart = at;
      return at + size <= end ? at + size : 0;
    }
    if (at >= end) return 0;
    memory.fill(literals, load<u8>(at), size);
    literalStart = literals;
    return at + 1;
  }
  const header = load<u64>(source) >> 4;
  const bits: u64 = format < 2 ? 10 : format === 2 ? 14 : 18;
  const mask: u64 = ((<u64>1) << bits) - 1;
  const size = <i32>(header & mask);
  const stored = <i32>((header >> bits) & mask);
  let at = source + (format < 2 ? 3 : format === 2 ? 4 : 5);
  const sectionEnd = at + stored;
  if (size > MAX_BLOCK || sectionEnd > end) return 0;
  if (type === 2) {
    if (!readHuffman(at, sectionEnd)) return 0;
    huffmanLog = tableLog;
    at += consumed;
  } else if (huffmanLog === 0) {
    return 0;
  }
  literalStart = literals;
  literalCount = size;
  if (format === 0) return huffman(at, sectionEnd, literals, size) ? sectionEnd : 0;
  const part = (size + 3) >> 2;
  const s1 = <usize>load<u16>(at);
  const s2 = <usize>load<u16>(at + 2);
  const s3 = <usize>load<u16>(at + 4);
  at += 6;
  if (at + s1 + s2 + s3 >= sectionEnd || 3 * part > size) return 0;
  return huffmanFour(at, s1, s2, s3, sectionEnd, part, size) ? sectionEnd : 0;
}

/**
 * Decode four Huffman streams side by side, because each symbol of one has to wait for the one before; their ends one
 * by one.
 */
function huffmanFour(source: usize, s1: usize, s2: usize, s3: usize, end: usize, part: i32, size: i32): bool {
  const start1 = source + s1;
  const start2 = start1 + s2;
  const start3 = start2 + s3;
  if (s1 === 0 || s2 === 0 || s3 === 0) return false;
  if (!load<u8>(start1 - 1) || !load<u8>(start2 - 1) || !load<u8>(start3 - 1) || !load<u8>(end - 1)) return false;
  const log = huffmanLog;
  const mask = (1 << log) - 1;
  let at0 = firstBit(source, start1);
  let at1 = firstBit(start1, start2);
  let at2 = firstBit(start2, start3);
  let at3 = firstBit(start3, end);
  let out = literals;
  // The last stream is the shortest.
  const last = literals + size - 3 * part;
  while (out + 5 <= last && at0 >= 57 && at1 >= 57 && at2 >= 57 && at3 >= 57) {
    const word0 = wordBelow(source, at0);
    const word1 = wordBelow(start1, at1);
    const word2 = wordBelow(start2, at2);
    const word3 = wordBelow(start3, at3);
    let bits0 = 57;
    let bits1 = 57;
    let bits2 = 57;
    let bits3 = 57;
    for (let i = 0; i < 5; i++, out++) {
      const e0 = <u32>load<u16>(huffmanTable + ((<usize>(word0 >>> (bits0 - log)) & mask) << 1));
      const e1 = <u32>load<u16>(huffmanTable + ((<usize>(word1 >>> (bits1 - log)) & mask) << 1));
      const e2 = <u32>load<u16>(huffmanTable + ((<usize>(word2 >>> (bits2 - log)) & mask) << 1));
      const e3 = <u32>load<u16>(huffmanTable + ((<usize>(word3 >>> (bits3 - log)) & mask) << 1));
      store<u8>(out, <u8>e0);
      store<u8>(out + part, <u8>e1);
      store<u8>(out + 2 * part, <u8>e2);
      store<u8>(out + 3 * part, <u8>e3);
      bits0 -= <i32>(e0 >> 8);
      bits1 -= <i32>(e1 >> 8);
      bits2 -= <i32>(e2 >> 8);
      bits3 -= <i32>(e3 >> 8);
    }
    at0 -= 57 - bits0;
    at1 -= 57 - bits1;
    at2 -= 57 - bits2;
    at3 -= 57 - bits3;
  }
  const done = <i32>(out - literals);
  return (
    huffmanFrom(source, at0, out, part - done) &&
    huffmanFrom(start1, at1, out + part, part - done) &&
    huffmanFrom(start2, at2, out + 2 * part, part - done) &&
    huffmanFrom(start3, at3, out + 3 * part, size - 3 * part - done)
  );
}

/** Return the number of bits of a stream: the highest set bit of its last byte marks its end. */
function firstBit(start: usize, end: usize): i32 {
  return ((<i32>(end - start)) << 3) - (<i32>clz<u32>(load<u8>(end - 1)) - 23);
}

/** The 57 bits below bit `at` of a stream. */
function wordBelow(start: usize, at: i32): u64 {
  const base = at - 57;
  return load<u64>(start + (base >> 3)) >>> (base & 7);
}

/** Decode one Huffman stream, from its last bit to its first; false unless it ends with its first bit. */
function huffman(start: usize, end: usize, target: usize, count: i32): bool {
  if (start >= end || load<u8>(end - 1) === 0) return false;
  return huffmanFrom(start, firstBit(start, end), target, count);
}

/** Decode `count` symbols from bit `at` of a stream down; false unless that is all of the stream. */
function huffmanFrom(start: usize, from: i32, target: usize, count: i32): bool {
  const log = huffmanLog;
  const mask = (1 << log) - 1;
  let at = from;
  let out = target;
  const last = target + count;
  // One load gives 57 bits at least: five codes of at most 11.
  while (out + 5 <= last && at >= 57) {
    const word = wordBelow(start, at);
    let bits = 57;
    for (let i = 0; i < 5; i++) {
      const entry = <u32>load<u16>(huffmanTable + ((<usize>(word >>> (bits - log)) & mask) << 1));
      store<u8>(out + i, <u8>entry);
      bits -= <i32>(entry >> 8);
    }
    out += 5;
    at -= 57 - bits;
  }
  for (; out < last; out++) {
    // Bits before the first one count as 0.
    const low = at - log;
    const index =
      low >= 0
        ? <i32>(load<u32>(start + (low >> 3)) >>> (low & 7)) & mask
        : at > 0
          ? ((<i32>load<u32>(start) & ((1 << at) - 1)) << -low) & mask
          : 0;
    const entry = <u32>load<u16>(huffmanTable + ((<usize>index) << 1));
    store<u8>(out, <u8>entry);
    at -= <i32>(entry >> 8);
    if (at < 0) return false;
  }
  return at === 0;
}

/** Carry out the sequences of a block (RFC 8878, 3.1.1.4); where its bytes end, or 0 where it is damaged. */
function sequences(start: usize, end: usize, count: i32, frame: usize, out: usize, outEnd: usize): usize {
  if (start >= end || load<u8>(end - 1) === 0) return 0;
  let at = ((<i32>(end - start)) << 3) - (<i32>clz<u32>(load<u8>(end - 1)) - 23);
  at -= lengthLog + offsetLog + matchLog;
  if (at < 0) return 0;
  let matchState = take(start, at, matchLog);
  let offsetState = take(start, at + matchLog, offsetLog);
  let lengthState = take(start, at + matchLog + offsetLog, lengthLog);
  let literal = literalStart;
  const literalEnd = literalStart + literalCount;
  for (let i = 0; i < count; i++) {
    const lengthEntry = load<u32>(lengthTable + ((<usize>lengthState) << 2));
    const offsetEntry = load<u32>(offsetTable + ((<usize>offsetState) << 2));
    const matchEntry = load<u32>(matchTable + ((<usize>matchState) << 2));
    const offsetCode = <i32>(offsetEntry & 255);
    const lengthCode = <usize>(lengthEntry & 255);
    const matchCode = <usize>(matchEntry & 255);
    const matchBits = <i32>load<u8>(MATCH_BITS + matchCode);
    const lengthBits = <i32>load<u8>(LENGTH_BITS + lengthCode);
    at -= offsetCode;
    if (at < 0) return 0;
    const offsetValue = ((<u32>1) << offsetCode) + take(start, at, offsetCode);
    at -= matchBits;
    if (at < 0) return 0;
    const matchLength = <i32>(load<u32>(MATCH_BASE + (matchCode << 2)) + take(start, at, matchBits));
    at -= lengthBits;
    if (at < 0) return 0;
    const literalLength = <i32>(load<u32>(LENGTH_BASE + (lengthCode << 2)) + take(start, at, lengthBits));
    if (i + 1 < count) {
      const b0 = <i32>((lengthEntry >> 8) & 255);
      const b1 = <i32>((matchEntry >> 8) & 255);
      const b2 = <i32>((offsetEntry >> 8) & 255);
      at -= b0 + b1 + b2;
      if (at < 0) return 0;
      lengthState = (lengthEntry >> 16) + take(start, at + b2 + b1, b0);
      matchState = (matchEntry >> 16) + take(start, at + b2, b1);
      offsetState = (offsetEntry >> 16) + take(start, at, b2);
    }
    let offset: u32;
    if (offsetValue > 3) {
      offset = offsetValue - 3;
      rep2 = rep1;
      rep1 = rep0;
      rep0 = offset;
    } else {
      const which = offsetValue + (literalLength === 0 ? 1 : 0);
      if (which === 1) {
        offset = rep0;
      } else {
        offset = which === 2 ? rep1 : which === 3 ? rep2 : rep0 - 1;
        if (which !== 2) rep2 = rep1;
        rep1 = rep0;
        rep0 = offset;
      }
    }
    if (literal + literalLength > literalEnd || out + literalLength + matchLength > outEnd) return 0;
    copy(out, literal, literalLength);
    literal += literalLength;
    out += literalLength;
    if (offset === 0 || <usize>offset > out - frame) return 0;
    copyMatch(out, offset, matchLength);
    out += matchLength;
  }
  if (at !== 0) return 0;
  const rest = <i32>(literalEnd - literal);
  if (out + rest > outEnd) return 0;
  memory.copy(out, literal, rest);
  return out + rest;
}

function take(start: usize, at: i32, count: i32): u32 {
  return <u32>((load<u64>(start + (at >> 3)) >>> (at & 7)) & (((<u64>1) << count) - 1));
}

/** Copy whole vectors; up to 15 bytes behind the end are written as well, and written again later. */
function copy(target: usize, source: usize, count: i32): void {
  for (let i = 0; i < count; i += 16) v128.store(target + i, v128.load(source + i));
}

function copyMatch(target: usize, offset: u32, count: i32): void {
  const source = target - offset;
  if (offset >= 16) {
    copy(target, source, count);
  } else if (offset === 1) {
    const value = i8x16.splat(load<i8>(source));
    for (let i = 0; i < count; i += 16) v128.store(target + i, value);
  } else {
    for (let i = 0; i < count; i++) store<u8>(target + i, load<u8>(source + i));
  }
}
