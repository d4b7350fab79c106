// Step model and sorted means: SPEC 6.5, 6.10, 6.15, 6.17.

const MAX_CLASS: u8 = 51;

/** Nine bits of a Morton code as three bits of x, at 0, of y, at 21, and of z, at 42; made at the first use. */
const ninths = memory.data(512 * 8);
let ninthsMade = false;
/** Steps of one axis for 0 to 30 bits. */
const axisSteps = memory.data(3 * 32 * 4);

/** Bits that Morton classes stand for; −1 for a class above 51. */
export function mortonBits(classes: usize, rows: i32): i32 {
  let bits = 0;
  let most: u8 = 0;
  for (let row = 0; row < rows; row++) {
    const bitLength = load<u8>(classes + row);
    most = max<u8>(most, bitLength);
    bits += max<i32>(<i32>bitLength - 1, 0);
  }
  return most > MAX_CLASS ? -1 : bits;
}

/** Axis codes of Morton differences; −1 for a code of 2^51 or more. */
export function morton(classes: usize, rows: i32, bits: usize, x: usize, y: usize, z: usize): i32 {
  if (!ninthsMade) makeNinths();
  let at = 0;
  let code: u64 = 0;
  for (let row = 0; row < rows; row++) {
    const bitLength = <i32>load<u8>(classes + row);
    if (bitLength > 0) {
      const count = bitLength - 1;
      const leading = (<u64>1) << count;
      code += leading + ((load<u64>(bits + (at >> 3)) >>> (at & 7)) & (leading - 1));
      at += count;
    }
    if (code >>> MAX_CLASS !== 0) return -1;
    let axes = ninth(code >>> 45);
    axes = (axes << 3) | ninth(code >>> 36);
    axes = (axes << 3) | ninth(code >>> 27);
    axes = (axes << 3) | ninth(code >>> 18);
    axes = (axes << 3) | ninth(code >>> 9);
    axes = (axes << 3) | ninth(code);
    store<u32>(x + (row << 2), <u32>axes & 0x1fffff);
    store<u32>(y + (row << 2), <u32>(axes >>> 21) & 0x1fffff);
    store<u32>(z + (row << 2), <u32>(axes >>> 42));
  }
  return 0;
}

function ninth(code: u64): u64 {
  return load<u64>(ninths + ((<usize>(code & 511)) << 3));
}

function makeNinths(): void {
  for (let code: u64 = 0; code < 512; code++) {
    let value: u64 = 0;
    for (let bit: u64 = 0; bit < 9; bit++) value |= ((code >>> bit) & 1) << (bit / 3 + 21 * (bit % 3));
    store<u64>(ninths + ((<usize>code) << 3), value);
  }
  ninthsMade = true;
}

/** Extra bits of each row from its scales and six coefficients. */
export function extraBits(s0: usize, s1: usize, s2: usize, rows: i32, coefficients: usize, target: usize): void {
  const c0 = v128.load_splat<f32>(coefficients);
  const c1 = v128.load_splat<f32>(coefficients, 4);
  const c2 = v128.load_splat<f32>(coefficients, 8);
  const c3 = v128.load_splat<f32>(coefficients, 12);
  const c4 = v128.load_splat<f32>(coefficients, 16);
  const c5 = v128.load_splat<f32>(coefficients, 20);
  const zero = f32x4.splat(0);
  const most = f32x4.splat(15);
  // Rows behind the last are computed as well: every reservation has room for a vector more.
  for (let row = 0; row < rows; row += 4) {
    const at = row << 2;
    const m = v128.load(s0 + at);
    const t = v128.load(s1 + at);
    const l = v128.load(s2 + at);
    const p = f32x4.sub(l, m);
    const q = f32x4.sub(m, t);
    let sum = f32x4.add(c0, f32x4.mul(c1, l));
    sum = f32x4.add(sum, f32x4.mul(c2, f32x4.min(p, f32x4.splat(1.5))));
    sum = f32x4.add(sum, f32x4.mul(c3, f32x4.min(p, f32x4.splat(5))));
    sum = f32x4.add(sum, f32x4.mul(c4, f32x4.min(q, f32x4.splat(0.5))));
    sum = f32x4.add(sum, f32x4.mul(c5, f32x4.min(q, f32x4.splat(3))));
    const h = i32x4.trunc_sat_f32x4_s(f32x4.max(f32x4.min(f32x4.floor(sum), most), zero));
    const narrow = i16x8.narrow_i32x4_u(h, h);
    v128.store32_lane(target + row, i8x16.narrow_i16x8_u(narrow, narrow), 0);
  }
}

/** Count the rows with 0, 1, … 15 extra bits into 16 u32. */
export function countBits(extra: usize, rows: i32, target: usize): void {
  memory.fill(target, 0, 64);
  for (let row = 0; row < rows; row++) {
    const count = target + ((<usize>load<u8>(extra + row)) << 2);
    store<u32>(count, load<u32>(count) + 1);
  }
}

/** Means of coarse axis codes, extra bits and perhaps refinement bits; −1 for a fine code below 0. */
export function sortedMeans(
  x: usize,
  y: usize,
  z: usize,
  extra: usize,
  rows: i32,
  bits: usize,
  refinement: usize,
  refinementBits: i32,
  axes: usize,
  targets: usize,
): i32 {
  for (let axis = 0; axis < 3; axis++) {
    const step = load<f32>(axes + (axis << 3));
    for (let h = 0; h <= 30; h++) {
      // The power of two is exact, so this rounds once, where the step becomes denormal.
      const power = reinterpret<f32>((127 - h) << 23);
      store<f32>(axisSteps + ((axis * 32 + h) << 2), step * power);
    }
  }
  const tx = <usize>load<u32>(targets);
  const ty = <usize>load<u32>(targets, 4);
  const tz = <usize>load<u32>(targets, 8);
  const mx = load<f32>(axes, 4);
  const my = load<f32>(axes, 12);
  const mz = load<f32>(axes, 20);
  const half: i64 = refinementBits > 0 ? (<i64>1) << (refinementBits - 1) : 0;
  const refinedMask: u64 = ((<u64>1) << refinementBits) - 1;
  let at = 0;
  let refinedAt = 0;
  for (let row = 0; row < rows; row++) {
    const h = <i32>load<u8>(extra + row);
    const mask: u64 = ((<u64>1) << h) - 1;
    // Three axes of at most 15 bits are in one load of 57.
    const low = load<u64>(bits + (at >> 3)) >>> (at & 7);
    at += 3 * h;
    const to = row << 2;
    let cx = ((<u64>load<u32>(x + to)) << h) | (low & mask);
    let cy = ((<u64>load<u32>(y + to)) << h) | ((low >>> h) & mask);
    let cz = ((<u64>load<u32>(z + to)) << h) | ((low >>> (2 * h)) & mask);
    if (refinementBits > 0) {
      const more = load<u64>(refinement + (refinedAt >> 3)) >>> (refinedAt & 7);
      refinedAt += 3 * refinementBits;
      const fx = <i64>((cx << refinementBits) + (more & refinedMask)) - half;
      const fy = <i64>((cy << refinementBits) + ((more >>> refinementBits) & refinedMask)) - half;
      const fz = <i64>((cz << refinementBits) + ((more >>> (2 * refinementBits)) & refinedMask)) - half;
      if ((fx | fy | fz) < 0) return -1;
      cx = fx;
      cy = fy;
      cz = fz;
    }
    const steps = axisSteps + ((h + refinementBits) << 2);
    store<f32>(tx + to, <f32>cx * load<f32>(steps) + mx);
    store<f32>(ty + to, <f32>cy * load<f32>(steps, 128) + my);
    store<f32>(tz + to, <f32>cz * load<f32>(steps, 256) + mz);
  }
  return 0;
}
