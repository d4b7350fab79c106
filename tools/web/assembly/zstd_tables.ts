// Tables of RFC 8878 that a zstd decoder builds: finite state entropy (4.1) and Huffman (4.2).

/** Most bits of a Huffman code (RFC 8878, 4.2.1). */
export const HUFFMAN_BITS: i32 = 11;

const MAX_SYMBOLS: i32 = 256;
const frequencies = memory.data(MAX_SYMBOLS * 2);
const states = memory.data(MAX_SYMBOLS * 2);
const weights = memory.data(MAX_SYMBOLS);
const weightTable = memory.data(64 * 4);
export const huffmanTable = memory.data(2 << HUFFMAN_BITS);

/** Bytes that the last description took. */
export let consumed: usize = 0;
/** Accuracy of the last FSE description, bits of the last Huffman tree. */
export let tableLog: i32 = 0;

// Predefined distributions (RFC 8878, 3.1.1.3.2.2).
const LITERAL_LENGTHS = memory.data<i8>([
  4, 3, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 3, 2, 1, 1, 1, 1, 1, -1, -1, -1, -1,
]);
const MATCH_LENGTHS = memory.data<i8>([
  1, 4, 3, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,
  1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1, -1, -1,
]);
const OFFSETS = memory.data<i8>([
  1, 1, 1, 1, 1, 1, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1,
]);

/** Build a table of a predefined distribution: 0 literal lengths, 1 offsets, 2 match lengths. */
export function predefined(which: i32, table: usize): i32 {
  const from = which === 0 ? LITERAL_LENGTHS : which === 1 ? OFFSETS : MATCH_LENGTHS;
  const count = which === 0 ? 36 : which === 1 ? 29 : 53;
  for (let s = 0; s < count; s++) store<i16>(frequencies + ((<usize>s) << 1), load<i8>(from + s));
  const log = which === 1 ? 5 : 6;
  build(table, count, log);
  return log;
}

/** Read a distribution and build its table (RFC 8878, 4.1.1); false where it is damaged. */
export function readFse(source: usize, end: usize, table: usize, maxSymbol: i32, maxLog: i32): bool {
  if (source >= end) return false;
  const bits = (<i32>(end - source)) << 3;
  let at = 4;
  const log = (<i32>load<u8>(source) & 15) + 5;
  if (log > maxLog) return false;
  let remaining = 1 << log;
  let symbol = 0;
  while (remaining > 0) {
    if (symbol > maxSymbol) return false;
    const count = 32 - clz<i32>(remaining + 1);
    const peek = <i32>(load<u32>(source + (at >> 3)) >>> (at & 7)) & ((1 << count) - 1);
    const mask = (1 << (count - 1)) - 1;
    const threshold = (1 << count) - 2 - remaining;
    let value = peek & mask;
    if (value < threshold) {
      at += count - 1;
    } else {
      value = peek > mask ? peek - threshold : peek;
      at += count;
    }
    if (at > bits) return false;
    const probability = value - 1;
    remaining -= probability < 0 ? 1 : probability;
    store<i16>(frequencies + ((<usize>symbol) << 1), <i16>probability);
    symbol++;
    if (probability === 0) {
      let repeat: i32;
      do {
        repeat = <i32>(load<u16>(source + (at >> 3)) >>> (at & 7)) & 3;
        at += 2;
        if (at > bits || symbol + repeat > maxSymbol + 1) return false;
        for (let i = 0; i < repeat; i++, symbol++) store<i16>(frequencies + ((<usize>symbol) << 1), 0);
      } while (repeat === 3);
    }
  }
  if (remaining !== 0) return false;
  build(table, symbol, log);
  consumed = (at + 7) >> 3;
  tableLog = log;
  return true;
}

/** A table of one state that always gives the same symbol. */
export function constant(table: usize, symbol: u8): void {
  store<u32>(table, symbol);
}

/** Spread the symbols of a distribution over the states (RFC 8878, 4.1.1). */
function build(table: usize, symbols: i32, log: i32): void {
  const size = 1 << log;
  let high = size;
  for (let s = 0; s < symbols; s++) {
    const frequency = <i32>load<i16>(frequencies + ((<usize>s) << 1));
    if (frequency === -1) {
      high--;
      store<u32>(table + ((<usize>high) << 2), s);
      store<u16>(states + ((<usize>s) << 1), 1);
    } else {
      store<u16>(states + ((<usize>s) << 1), <u16>frequency);
    }
  }
  const step = (size >> 1) + (size >> 3) + 3;
  const mask = size - 1;
  let position = 0;
  for (let s = 0; s < symbols; s++) {
    const frequency = <i32>load<i16>(frequencies + ((<usize>s) << 1));
    for (let i = 0; i < frequency; i++) {
      store<u32>(table + ((<usize>position) << 2), s);
      do {
        position = (position + step) & mask;
      } while (position >= high);
    }
  }
  for (let i = 0; i < size; i++) {
    const entry = table + ((<usize>i) << 2);
    const symbol = load<u32>(entry);
    const next = <i32>load<u16>(states + ((<usize>symbol) << 1));
    store<u16>(states + ((<usize>symbol) << 1), <u16>(next + 1));
    const bits = log - (31 - clz<i32>(next));
    store<u32>(entry, symbol | (bits << 8) | (((next << bits) - size) << 16));
  }
}

/** Read a Huffman tree and build its table (RFC 8878, 4.2.1); false where it is damaged. */
export function readHuffman(source: usize, end: usize): bool {
  if (source >= end) return false;
  const header = <i32>load<u8>(source);
  let count = 0;
  if (header >= 128) {
    count = header - 127;
    if (source + 1 + ((count + 1) >> 1) > end) return false;
    for (let i = 0; i < count; i++) {
      const byte = <i32>load<u8>(source + 1 + (i >> 1));
      store<u8>(weights + i, <u8>(i & 1 ? byte & 15 : byte >> 4));
    }
    consumed = 1 + ((count + 1) >> 1);
  } else {
    if (source + 1 + header > end) return false;
    count = readWeights(source + 1, source + 1 + header);
    if (count < 0) return false;
    consumed = 1 + header;
  }
  return buildHuffman(count);
}

/** Weights that two FSE states give in turn, from the last bit to the first; their number, or −1. */
function readWeights(source: usize, end: usize): i32 {
  if (!readFse(source, end, weightTable, 255, 6)) return -1;
  const log = tableLog;
  const start = source + consumed;
  if (start >= end || load<u8>(end - 1) === 0) return -1;
  let at = ((<i32>(end - start)) << 3) - (<i32>clz<u32>(load<u8>(end - 1)) - 23);
  at -= log;
  let first = bitsAt(start, at, log);
  at -= log;
  let second = bitsAt(start, at, log);
  if (at < 0) return -1;
  let count = 0;
  while (true) {
    const entry = load<u32>(weightTable + ((<usize>first) << 2));
    store<u8>(weights + count++, <u8>entry);
    const bits = <i32>((entry >> 8) & 255);
    at -= bits;
    if (at < 0) {
      // The other state still gives the symbol that it stands for.
      if (count > 254) return -1;
      store<u8>(weights + count++, <u8>load<u32>(weightTable + ((<usize>second) << 2)));
      return count;
    }
    if (count > 254) return -1;
    first = (entry >> 16) + bitsAt(start, at, bits);
    const swap = first;
    first = second;
    second = swap;
  }
}

function bitsAt(start: usize, at: i32, count: i32): u32 {
  if (at < 0) return 0;
  return <u32>(load<u64>(start + (at >> 3)) >>> (at & 7)) & ((1 << count) - 1);
}

/** Fill the table of 2^bits entries: symbol, length of its code. */
function buildHuffman(count: i32): bool {
  let sum: u32 = 0;
  let longest = 0;
  for (let i = 0; i < count; i++) {
    const weight = load<u8>(weights + i);
    if (weight > 12) return false;
    if (weight > 0) sum += 1 << (weight - 1);
    if (weight === 1) longest++;
  }
  if (sum === 0) return false;
  const log = 32 - <i32>clz<u32>(sum);
  if (log > HUFFMAN_BITS) return false;
  const left = ((<u32>1) << log) - sum;
  if (left === 0 || (left & (left - 1)) !== 0) return false;
  // The longest codes, of weight 1, come in pairs.
  if (left === 1) longest++;
  if (longest < 2) return false;
  store<u8>(weights + count, <u8>(32 - clz<u32>(left)));
  count++;
  let at: usize = huffmanTable;
  for (let weight = 1; weight <= log; weight++) {
    const entries = 1 << (weight - 1);
    for (let symbol = 0; symbol < count; symbol++) {
      if (load<u8>(weights + symbol) !== weight) continue;
      const entry = <u16>(symbol | ((log + 1 - weight) << 8));
      for (let i = 0; i < entries; i++) {
        store<u16>(at, entry);
        at += 2;
      }
    }
  }
  tableLog = log;
  return true;
}
