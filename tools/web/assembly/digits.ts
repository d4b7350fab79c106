// Packed planes of SPEC 6.9: several symbols to the byte.

/** For each radix from 2 to 16 the symbols of every byte, eight bytes each; made when a radix first occurs. */
const tables = memory.data(17 * 256 * 8);
const made = memory.data(17);

/** Unpack `length` symbols; −1 for a byte or symbol that cannot be. */
export function unpackDigits(source: usize, length: i32, radix: i32, target: usize): i32 {
  const perByte = radix === 2 ? 8 : radix === 3 ? 5 : radix === 4 ? 4 : radix <= 6 ? 3 : 2;
  let limit = radix;
  for (let i = 1; i < perByte; i++) limit *= radix;
  const table = tables + radix * 2048;
  if (load<u8>(made + radix) === 0) makeTable(table, radix, perByte, limit);
  const whole = length / perByte;
  let out = target;
  for (let i = 0; i < whole; i++, out += perByte) {
    const byte = <i32>load<u8>(source + i);
    if (byte >= limit) return -1;
    // Writes eight bytes, of which later bytes replace those behind the symbols.
    store<u64>(out, load<u64>(table + ((<usize>byte) << 3)));
  }
  const rest = length - whole * perByte;
  if (rest > 0) {
    let byte = <i32>load<u8>(source + whole);
    if (byte >= limit) return -1;
    for (let i = 0; i < rest; i++, byte /= radix) store<u8>(out + i, <u8>(byte % radix));
    if (byte !== 0) return -1;
  }
  return 0;
}

function makeTable(table: usize, radix: i32, perByte: i32, limit: i32): void {
  for (let byte = 0; byte < limit; byte++) {
    let rest = byte;
    for (let i = 0; i < perByte; i++, rest /= radix) store<u8>(table + (byte << 3) + i, <u8>(rest % radix));
  }
  store<u8>(made + radix, 1);
}
