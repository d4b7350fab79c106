// What a renderer uploads: 16 bytes a splat, and SH bands as packed bits (src/scene/packed_splats.ts describes both).
// Viewers may round (SPEC 8.6), so exp and acos are polynomials here.

/** Range of log scales that one byte stands for, and steps of it. */
const LOG_MIN: f32 = -12;
const LOG_STEPS: f32 = 254 / 21;
const SH_C0: f32 = 0.28209479177387814;

/**
 * Pack splats, four at a time; rows behind the last are packed as well.
 *
 * @param columns - Addresses of 14 columns: means, scales, quats, opacities, sh0.
 * @param rgbMin - Colour that byte 0 stands for; `rgbMax` that of byte 255.
 */
export function packSplats(columns: usize, rows: i32, rgbMin: f32, rgbMax: f32, target: usize): void {
  const colourScale = f32x4.splat(SH_C0 / (rgbMax - rgbMin));
  const colourShift = f32x4.splat((0.5 - rgbMin) / (rgbMax - rgbMin));
  for (let row = 0; row < rows; row += 4) {
    const at = row << 2;
    const red = colour(column(columns, 11, at), colourScale, colourShift);
    const green = colour(column(columns, 12, at), colourScale, colourShift);
    const blue = colour(column(columns, 13, at), colourScale, colourShift);
    const w0 = v128.or(
      v128.or(red, i32x4.shl(green, 8)),
      v128.or(i32x4.shl(blue, 16), i32x4.shl(alpha(column(columns, 10, at)), 24)),
    );
    const w1 = v128.or(half(column(columns, 0, at)), i32x4.shl(half(column(columns, 1, at)), 16));
    const rotation = octahedral(
      column(columns, 6, at),
      column(columns, 7, at),
      column(columns, 8, at),
      column(columns, 9, at),
    );
    const w2 = v128.or(half(column(columns, 2, at)), i32x4.shl(rotation, 16));
    const w3 = v128.or(
      v128.or(scale(column(columns, 3, at)), i32x4.shl(scale(column(columns, 4, at)), 8)),
      v128.or(i32x4.shl(scale(column(columns, 5, at)), 16), i32x4.shl(i32x4.shr_u(rotation, 16), 24)),
    );
    // Four columns of words become four splats.
    const a = v128.shuffle<i32>(w0, w1, 0, 4, 1, 5);
    const b = v128.shuffle<i32>(w2, w3, 0, 4, 1, 5);
    const c = v128.shuffle<i32>(w0, w1, 2, 6, 3, 7);
    const d = v128.shuffle<i32>(w2, w3, 2, 6, 3, 7);
    const to = target + (row << 4);
    v128.store(to, v128.shuffle<i64>(a, b, 0, 2));
    v128.store(to, v128.shuffle<i64>(a, b, 1, 3), 16);
    v128.store(to, v128.shuffle<i64>(c, d, 0, 2), 32);
    v128.store(to, v128.shuffle<i64>(c, d, 1, 3), 48);
  }
}

function column(columns: usize, number: usize, at: i32): v128 {
  return v128.load(<usize>load<u32>(columns + (number << 2)) + at);
}

/** A byte of 0 to 255 from a number of 0 to 1; NaN gives 0. */
function byte(value: v128): v128 {
  const clamped = f32x4.min(f32x4.max(f32x4.mul(value, f32x4.splat(255)), f32x4.splat(0)), f32x4.splat(255));
  return i32x4.trunc_sat_f32x4_s(f32x4.nearest(clamped));
}

function colour(sh0: v128, scale: v128, shift: v128): v128 {
  return byte(f32x4.add(f32x4.mul(sh0, scale), shift));
}

/** The logistic function of a logit, as a byte. */
function alpha(logit: v128): v128 {
  const y = f32x4.max(f32x4.min(f32x4.mul(logit, f32x4.splat(-Mathf.LOG2E)), f32x4.splat(30)), f32x4.splat(-30));
  const whole = f32x4.floor(y);
  const f = f32x4.sub(y, whole);
  // 2^f for 0 ≤ f < 1 by the first terms of its series around ½: good to 3e-5.
  let power = f32x4.add(f32x4.mul(f32x4.splat(0.01353), f), f32x4.splat(0.05204));
  power = f32x4.add(f32x4.mul(power, f), f32x4.splat(0.24135));
  power = f32x4.add(f32x4.mul(power, f), f32x4.splat(0.69307));
  power = f32x4.add(f32x4.mul(power, f), f32x4.splat(1));
  const exponent = i32x4.shl(i32x4.add(i32x4.trunc_sat_f32x4_s(whole), i32x4.splat(127)), 23);
  return byte(f32x4.div(f32x4.splat(1), f32x4.add(f32x4.splat(1), f32x4.mul(power, exponent))));
}

/** A log scale as a byte of 1 to 255. */
function scale(log: v128): v128 {
  const steps = f32x4.mul(f32x4.sub(log, f32x4.splat(LOG_MIN)), f32x4.splat(LOG_STEPS));
  const clamped = f32x4.min(f32x4.max(steps, f32x4.splat(0)), f32x4.splat(254));
  return i32x4.add(i32x4.trunc_sat_f32x4_s(f32x4.nearest(clamped)), i32x4.splat(1));
}

/** Half floats, rounded to nearest; below the normal range by float arithmetic, above it the largest. */
function half(value: v128): v128 {
  const sign = v128.and(i32x4.shr_u(value, 16), i32x4.splat(0x8000));
  const magnitude = f32x4.min(f32x4.abs(value), f32x4.splat(65504));
  // 2^-14 and less: adding 2^-1 leaves the half's 10 bits at the end of the float's mantissa.
  const small = i32x4.sub(f32x4.add(magnitude, f32x4.splat(0.5)), i32x4.splat(0x3f000000));
  const odd = v128.and(i32x4.shr_u(magnitude, 13), i32x4.splat(1));
  const rounded = i32x4.add(i32x4.add(magnitude, i32x4.splat(0xfff)), odd);
  const normal = i32x4.shr_u(i32x4.sub(rounded, i32x4.splat(0x38000000)), 13);
  const isSmall = i32x4.lt_s(magnitude, i32x4.splat(0x38800000));
  return v128.or(sign, v128.bitselect(small, normal, isSmall));
}

/** A rotation as its axis on an octahedron, two bytes, and its angle, one byte. */
function octahedral(w: v128, x: v128, y: v128, z: v128): v128 {
  const zero = f32x4.splat(0);
  const one = f32x4.splat(1);
  const sum = f32x4.add(f32x4.add(f32x4.abs(x), f32x4.abs(y)), f32x4.abs(z));
  const isNone = f32x4.lt(sum, f32x4.splat(1e-6));
  const scale = f32x4.div(one, v128.bitselect(one, sum, isNone));
  const px = v128.bitselect(one, f32x4.mul(x, scale), isNone);
  const py = f32x4.mul(y, scale);
  const signs = f32x4.splat(-0.0);
  const folded = f32x4.lt(z, zero);
  const fx = v128.or(f32x4.sub(one, f32x4.abs(py)), v128.and(px, signs));
  const fy = v128.or(f32x4.sub(one, f32x4.abs(px)), v128.and(py, signs));
  const u = byte(f32x4.add(f32x4.mul(v128.bitselect(fx, px, folded), f32x4.splat(0.5)), f32x4.splat(0.5)));
  const v = byte(f32x4.add(f32x4.mul(v128.bitselect(fy, py, folded), f32x4.splat(0.5)), f32x4.splat(0.5)));
  return v128.or(v128.or(u, i32x4.shl(v, 8)), i32x4.shl(angle(w), 16));
}

/** 2·acos(w)/π as a byte, by Abramowitz and Stegun 4.4.45: good to 7e-5 radians. */
function angle(w: v128): v128 {
  const c = f32x4.min(f32x4.max(w, f32x4.splat(0)), f32x4.splat(1));
  let series = f32x4.add(f32x4.mul(f32x4.splat(-0.0187293), c), f32x4.splat(0.074261));
  series = f32x4.add(f32x4.mul(series, c), f32x4.splat(-0.2121144));
  series = f32x4.add(f32x4.mul(series, c), f32x4.splat(1.5707288));
  const acos = f32x4.mul(f32x4.sqrt(f32x4.sub(f32x4.splat(1), c)), series);
  return byte(f32x4.mul(acos, f32x4.splat(0.63661977)));
}

/**
 * Pack SH bands: 9 values of 7 bits, 15 of 8, 21 of 6.
 *
 * @param source - Rows of 9, 24 or 45 floats.
 * @param range - Magnitude that the largest code stands for.
 */
export function packShn(source: usize, rows: i32, degree: i32, range: f32, sh1: usize, sh2: usize, sh3: usize): void {
  const stride: usize = degree === 3 ? 180 : degree === 2 ? 96 : 36;
  const scale7 = f32x4.splat(63 / range);
  const scale8 = f32x4.splat(127 / range);
  const scale6 = f32x4.splat(31 / range);
  const most7 = f32x4.splat(63);
  const most8 = f32x4.splat(127);
  const most6 = f32x4.splat(31);
  let from = source;
  for (let row = 0; row < rows; row++, from += stride) {
    const low = bytes(
      quantise(from, scale7, most7),
      quantise(from + 16, scale7, most7),
      quantise(from + 32, scale7, most7),
      f32x4.splat(0),
    );
    const ninth = <u64>i8x16.extract_lane_u(low, 8) & 127;
    store<u64>(sh1 + (row << 3), squeeze7(i64x2.extract_lane(low, 0)) | (ninth << 56));
    if (degree < 2) continue;
    const middle = bytes(
      quantise(from + 36, scale8, most8),
      quantise(from + 52, scale8, most8),
      quantise(from + 68, scale8, most8),
      quantise(from + 84, scale8, most8),
    );
    v128.store(sh2 + (row << 4), i8x16.replace_lane(middle, 15, 0));
    if (degree < 3) continue;
    const high = bytes(
      quantise(from + 96, scale6, most6),
      quantise(from + 112, scale6, most6),
      quantise(from + 128, scale6, most6),
      quantise(from + 144, scale6, most6),
    );
    const rest = bytes(
      quantise(from + 160, scale6, most6),
      quantise(from + 176, scale6, most6),
      f32x4.splat(0),
      f32x4.splat(0),
    );
    const a = squeeze6(i64x2.extract_lane(high, 0));
    const b = squeeze6(i64x2.extract_lane(high, 1));
    const c = squeeze6(i64x2.extract_lane(rest, 0) & 0xffffffffff);
    store<u64>(sh3 + (row << 4), a | (b << 48));
    store<u64>(sh3 + (row << 4), (b >>> 16) | (c << 32), 8);
  }
}

function quantise(from: usize, scale: v128, most: v128): v128 {
  const value = f32x4.mul(v128.load(from), scale);
  return i32x4.trunc_sat_f32x4_s(f32x4.nearest(f32x4.max(f32x4.min(value, most), f32x4.neg(most))));
}

function bytes(a: v128, b: v128, c: v128, d: v128): v128 {
  return i8x16.narrow_i16x8_s(i16x8.narrow_i32x4_s(a, b), i16x8.narrow_i32x4_s(c, d));
}

/** The low seven bits of eight bytes, side by side. */
function squeeze7(value: u64): u64 {
  let x = (value & 0x007f007f007f007f) | ((value & 0x7f007f007f007f00) >>> 1);
  x = (x & 0x00003fff00003fff) | ((x & 0x3fff00003fff0000) >>> 2);
  return (x & 0x0fffffff) | ((x >>> 32) << 28);
}

/** The low six bits of eight bytes, side by side. */
function squeeze6(value: u64): u64 {
  let x = (value & 0x003f003f003f003f) | ((value & 0x3f003f003f003f00) >>> 2);
  x = (x & 0x00000fff00000fff) | ((x & 0x0fff00000fff0000) >>> 4);
  return (x & 0x00ffffff) | ((x >>> 32) << 24);
}
