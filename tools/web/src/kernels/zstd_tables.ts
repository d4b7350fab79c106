// Tables that a zstd decoder builds, from RFC 8878: finite state entropy (4.1) and Huffman (4.2).

/** Most bits of a Huffman code (RFC 8878, 4.2.1). */
const HUFFMAN_BITS = 11;

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
export function bitsAt(bytes: Uint8Array, start: number, at: number, count: number): number {
  if (count > 16) return bitsAt(bytes, start, at, 16) + bitsAt(bytes, start, at + 16, count - 16) * 65_536;
  const byte = start + (at >>> 3);
  const word = bytes[byte]! | (bytes[byte + 1]! << 8) | (bytes[byte + 2]! << 16);
  return (word >>> (at & 7)) & ((1 << count) - 1);
}

/** Where a string of bits begins that ends with a set bit at `end`; −1 where its last byte is 0 or it is empty. */
export function firstBit(bytes: Uint8Array, start: number, end: number): number {
  if (start >= end || bytes[end - 1] === 0) return -1;
  return 8 * (end - start) - (Math.clz32(bytes[end - 1]!) - 23);
}

/** Read a distribution and build its table (RFC 8878, 4.1.1); undefined where it is damaged. */
export function readFse(
  bytes: Uint8Array, start: number, end: number, maxSymbol: number, maxLog: number,
): Table | undefined {
  if (start >= end) return undefined;
  const bits = 8 * (end - start);
  const log = (bytes[start]! & 15) + 5;
  if (log > maxLog) return undefined;
  const probabilities: number[] = [];
  let at = 4;
  let remaining = 1 << log;
  while (remaining > 0) {
    if (probabilities.length > maxSymbol) return undefined;
    const count = 32 - Math.clz32(remaining + 1);
    const peek = bitsAt(bytes, start, at, count);
    const mask = (1 << (count - 1)) - 1;
    const threshold = (1 << count) - 2 - remaining;
    const isShort = (peek & mask) < threshold;
    const value = isShort ? peek & mask : peek > mask ? peek - threshold : peek;
    at += isShort ? count - 1 : count;
    if (at > bits) return undefined;
    const probability = value - 1;
    remaining -= probability < 0 ? 1 : probability;
    probabilities.push(probability);
    if (probability !== 0) continue;
    for (let repeat = 3; repeat === 3; ) {
      repeat = bitsAt(bytes, start, at, 2);
      at += 2;
      if (at > bits || probabilities.length + repeat > maxSymbol + 1) return undefined;
      for (let i = 0; i < repeat; i++) probabilities.push(0);
    }
  }
  return remaining === 0 ? fseTable(probabilities, log, (at + 7) >> 3) : undefined;
}

/** Spread the symbols of a distribution over the states (RFC 8878, 4.1.1). */
export function fseTable(probabilities: readonly number[], log: number, consumed = 0): Table {
  const size = 1 << log;
  const symbols = new Uint8Array(size);
  let high = size;
  probabilities.forEach((probability, symbol) => {
    if (probability < 0) symbols[--high] = symbol;
  });
  const step = (size >> 1) + (size >> 3) + 3;
  let position = 0;
  probabilities.forEach((probability, symbol) => {
    for (let i = 0; i < probability; i++) {
      symbols[position] = symbol;
      do position = (position + step) & (size - 1);
      while (position >= high);
    }
  });
  const next = probabilities.map(Math.abs);
  const bits = new Uint8Array(size);
  const bases = new Uint16Array(size);
  for (let state = 0; state < size; state++) {
    const value = next[symbols[state]!]!++;
    bits[state] = log - (31 - Math.clz32(value));
    bases[state] = (value << bits[state]!) - size;
  }
  return { log, symbols, bits, bases, consumed };
}

/** A table of one state that always gives the same symbol. */
export function constantTable(symbol: number): Table {
  return { log: 0, symbols: Uint8Array.of(symbol), bits: new Uint8Array(1), bases: new Uint16Array(1), consumed: 1 };
}

/** Read a Huffman tree (RFC 8878, 4.2.1); undefined where it is damaged. */
export function readHuffman(bytes: Uint8Array, start: number, end: number): Table | undefined {
  if (start >= end) return undefined;
  const header = bytes[start]!;
  if (header < 128) {
    if (start + 1 + header > end) return undefined;
    const weights = readWeights(bytes, start + 1, start + 1 + header);
    return weights && huffmanTable(weights, 1 + header);
  }
  const count = header - 127;
  const consumed = 1 + ((count + 1) >> 1);
  if (start + consumed > end) return undefined;
  const weights = Array.from({ length: count }, (_, i) => {
    const byte = bytes[start + 1 + (i >> 1)]!;
    return i & 1 ? byte & 15 : byte >> 4;
  });
  return huffmanTable(weights, consumed);
}

/** Weights that two states give in turn, from the last bit to the first. */
function readWeights(bytes: Uint8Array, start: number, end: number): number[] | undefined {
  const table = readFse(bytes, start, end, 255, 6);
  if (table === undefined) return undefined;
  const from = start + table.consumed;
  let at = firstBit(bytes, from, end) - 2 * table.log;
  if (at < 0) return undefined;
  let now = bitsAt(bytes, from, at + table.log, table.log);
  let other = bitsAt(bytes, from, at, table.log);
  const weights: number[] = [];
  for (;;) {
    weights.push(table.symbols[now]!);
    at -= table.bits[now]!;
    if (weights.length > 254) return undefined;
    if (at < 0) {
      // The other state still gives the symbol that it stands for.
      weights.push(table.symbols[other]!);
      return weights;
    }
    const next = table.bases[now]! + bitsAt(bytes, from, at, table.bits[now]!);
    [now, other] = [other, next];
  }
}

/** The table of 2^log entries, by the bits of a code and whatever follows it. */
function huffmanTable(weights: number[], consumed: number): Table | undefined {
  if (weights.some((weight) => weight > 12)) return undefined;
  const sum = weights.reduce((total, weight) => total + (weight > 0 ? 1 << (weight - 1) : 0), 0);
  if (sum === 0) return undefined;
  const log = 32 - Math.clz32(sum);
  const left = (1 << log) - sum;
  if (log > HUFFMAN_BITS || (left & (left - 1)) !== 0) return undefined;
  const all = [...weights, 32 - Math.clz32(left)];
  const symbols = new Uint8Array(1 << log);
  const bits = new Uint8Array(1 << log);
  let at = 0;
  for (let weight = 1; weight <= log; weight++) {
    all.forEach((found, symbol) => {
      if (found !== weight) return;
      const end = at + (1 << (weight - 1));
      symbols.fill(symbol, at, end);
      bits.fill(log + 1 - weight, at, end);
      at = end;
    });
  }
  return { log, symbols, bits, bases: new Uint16Array(0), consumed };
}
