// SH above DC on a basis: SPEC 6.14.

/** Bytes between two rows of the basis: 48 floats. */
const ROW: usize = 192;
const next = memory.data(256 * 4);

/** Rows in the order of falling ends, and how many rows have each end; −1 for an end above `width`. */
export function shnOrder(ends: usize, rows: i32, width: i32, order: usize, counts: usize): i32 {
  memory.fill(counts, 0, (<usize>width + 1) << 2);
  for (let row = 0; row < rows; row++) {
    const end = <i32>load<u8>(ends + row);
    if (end > width) return -1;
    const count = counts + (end << 2);
    store<u32>(count, load<u32>(count) + 1);
  }
  let at: u32 = 0;
  for (let end = width; end >= 0; end--) {
    store<u32>(next + (end << 2), at);
    at += load<u32>(counts + (end << 2));
  }
  for (let row = 0; row < rows; row++) {
    const slot = next + ((<usize>load<u8>(ends + row)) << 2);
    const to = load<u32>(slot);
    store<u32>(slot, to + 1);
    store<u32>(order + ((<usize>to) << 2), row);
  }
  return 0;
}

/** Coordinates of codes; `plus` is 1 for last codes, which are stored less one. */
export function shnValues(
  p0: usize,
  p1: usize,
  p2: usize,
  rows: i32,
  plus: i32,
  step: f32,
  shrink: f32,
  target: usize,
): void {
  let row = 0;
  if (p2 === 0) {
    const steps = f32x4.splat(step);
    const shrinks = f32x4.splat(shrink);
    const one = i16x8.splat(1);
    const added = i16x8.splat(<i16>plus);
    // Codes of two bytes and one more would leave 16 bits.
    if (p1 === 0) {
      for (const whole = rows & ~7; row < whole; row += 8) {
        const k = i16x8.add(p0 ? v128.load_ext<u8>(p0 + row) : i16x8.splat(0), added);
        const half = i16x8.shr_u(i16x8.add(k, one), 1);
        v128.store(
          target + (row << 2),
          coordinate(i32x4.extend_low_i16x8_u(k), i32x4.extend_low_i16x8_u(half), shrinks, steps),
        );
        v128.store(
          target + (row << 2),
          coordinate(i32x4.extend_high_i16x8_u(k), i32x4.extend_high_i16x8_u(half), shrinks, steps),
          16,
        );
      }
    }
  }
  for (; row < rows; row++) {
    let k: u32 = p0 ? load<u8>(p0 + row) : 0;
    if (p1) k |= (<u32>load<u8>(p1 + row)) << 8;
    if (p2) k |= (<u32>load<u8>(p2 + row)) << 16;
    k += plus;
    const magnitude = (<f32>((k + 1) >> 1) - shrink) * step;
    store<f32>(target + (row << 2), k === 0 ? 0 : k & 1 ? magnitude : -magnitude);
  }
}

function coordinate(k: v128, half: v128, shrinks: v128, steps: v128): v128 {
  const magnitude = f32x4.mul(f32x4.sub(f32x4.convert_i32x4_u(half), shrinks), steps);
  const sign = i32x4.shl(i32x4.sub(v128.and(k, i32x4.splat(1)), i32x4.splat(1)), 31);
  return v128.and(v128.xor(magnitude, sign), i32x4.ne(k, i32x4.splat(0)));
}

/**
 * Sum a row's coordinates times the basis into rows of 9, 24 or 45 floats.
 *
 * A coordinate of 0 adds ±0 to a sum that is never −0, which changes no bit, so it needs no test.
 */
export function shnSum(
  order: usize,
  counts: usize,
  width: i32,
  columns: usize,
  basis: usize,
  floats: i32,
  target: usize,
): void {
  let at = 0;
  for (let end = width; end >= 0; end--) {
    const last = at + <i32>load<u32>(counts + (end << 2));
    for (; at < last; at++) {
      const to = target + <usize>load<u32>(order + (at << 2)) * ((<usize>floats) << 2);
      if (floats === 45) sum45(at, end, columns, basis, to);
      else if (floats === 24) sum24(at, end, columns, basis, to);
      else sum9(at, end, columns, basis, to);
    }
  }
}

function value(columns: usize, j: i32, at: i32): v128 {
  return v128.load_splat<f32>(<usize>load<u32>(columns + (j << 2)) + (at << 2));
}

function plus(sum: v128, v: v128, basis: usize, offset: usize): v128 {
  return f32x4.add(sum, f32x4.mul(v, v128.load(basis + offset)));
}

function sum45(at: i32, end: i32, columns: usize, basis: usize, to: usize): void {
  let s0 = f32x4.splat(0);
  let s1 = s0;
  let s2 = s0;
  let s3 = s0;
  let s4 = s0;
  let s5 = s0;
  let s6 = s0;
  let s7 = s0;
  let s8 = s0;
  let s9 = s0;
  let s10 = s0;
  let s11 = s0;
  for (let j = 0; j < end; j++, basis += ROW) {
    const v = value(columns, j, at);
    s0 = plus(s0, v, basis, 0);
    s1 = plus(s1, v, basis, 16);
    s2 = plus(s2, v, basis, 32);
    s3 = plus(s3, v, basis, 48);
    s4 = plus(s4, v, basis, 64);
    s5 = plus(s5, v, basis, 80);
    s6 = plus(s6, v, basis, 96);
    s7 = plus(s7, v, basis, 112);
    s8 = plus(s8, v, basis, 128);
    s9 = plus(s9, v, basis, 144);
    s10 = plus(s10, v, basis, 160);
    s11 = plus(s11, v, basis, 176);
  }
  v128.store(to, s0);
  v128.store(to, s1, 16);
  v128.store(to, s2, 32);
  v128.store(to, s3, 48);
  v128.store(to, s4, 64);
  v128.store(to, s5, 80);
  v128.store(to, s6, 96);
  v128.store(to, s7, 112);
  v128.store(to, s8, 128);
  v128.store(to, s9, 144);
  v128.store(to, s10, 160);
  v128.store32_lane(to, s11, 0, 176);
}

function sum24(at: i32, end: i32, columns: usize, basis: usize, to: usize): void {
  let s0 = f32x4.splat(0);
  let s1 = s0;
  let s2 = s0;
  let s3 = s0;
  let s4 = s0;
  let s5 = s0;
  for (let j = 0; j < end; j++, basis += ROW) {
    const v = value(columns, j, at);
    s0 = plus(s0, v, basis, 0);
    s1 = plus(s1, v, basis, 16);
    s2 = plus(s2, v, basis, 32);
    s3 = plus(s3, v, basis, 48);
    s4 = plus(s4, v, basis, 64);
    s5 = plus(s5, v, basis, 80);
  }
  v128.store(to, s0);
  v128.store(to, s1, 16);
  v128.store(to, s2, 32);
  v128.store(to, s3, 48);
  v128.store(to, s4, 64);
  v128.store(to, s5, 80);
}

function sum9(at: i32, end: i32, columns: usize, basis: usize, to: usize): void {
  let s0 = f32x4.splat(0);
  let s1 = s0;
  let s2 = s0;
  for (let j = 0; j < end; j++, basis += ROW) {
    const v = value(columns, j, at);
    s0 = plus(s0, v, basis, 0);
    s1 = plus(s1, v, basis, 16);
    s2 = plus(s2, v, basis, 32);
  }
  v128.store(to, s0);
  v128.store(to, s1, 16);
  v128.store32_lane(to, s2, 0, 32);
}
