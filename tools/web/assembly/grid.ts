// Codes and values on grids: SPEC 6.4, 6.8, 6.12, 6.13, 6.16.

/** Codes of 0 to 3 byte planes; −1 for one of `limit` or more. */
export function codes(p0: usize, p1: usize, p2: usize, rows: i32, limit: u32, target: usize): i32 {
  let row = 0;
  if (p2 === 0) {
    const whole = rows & ~7;
    let most = i16x8.splat(0);
    for (; row < whole; row += 8) {
      let v = p0 ? v128.load_ext<u8>(p0 + row) : i16x8.splat(0);
      if (p1) v = v128.or(v, i16x8.shl(v128.load_ext<u8>(p1 + row), 8));
      most = i16x8.max_u(most, v);
      v128.store(target + (row << 2), i32x4.extend_low_i16x8_u(v));
      v128.store(target + (row << 2), i32x4.extend_high_i16x8_u(v), 16);
    }
    let largest: u32 = 0;
    largest = max<u32>(largest, max<u32>(i16x8.extract_lane_u(most, 0), i16x8.extract_lane_u(most, 1)));
    largest = max<u32>(largest, max<u32>(i16x8.extract_lane_u(most, 2), i16x8.extract_lane_u(most, 3)));
    largest = max<u32>(largest, max<u32>(i16x8.extract_lane_u(most, 4), i16x8.extract_lane_u(most, 5)));
    largest = max<u32>(largest, max<u32>(i16x8.extract_lane_u(most, 6), i16x8.extract_lane_u(most, 7)));
    if (largest >= limit) return -1;
  }
  for (; row < rows; row++) {
    let code: u32 = p0 ? load<u8>(p0 + row) : 0;
    if (p1) code |= (<u32>load<u8>(p1 + row)) << 8;
    if (p2) code |= (<u32>load<u8>(p2 + row)) << 16;
    if (code >= limit) return -1;
    store<u32>(target + (row << 2), code);
  }
  return 0;
}

/** Values of codes, every `stride` floats. */
export function gridValues(source: usize, rows: i32, step: f32, minimum: f32, target: usize, stride: i32): void {
  let row = 0;
  if (stride === 1) {
    const steps = f32x4.splat(step);
    const minima = f32x4.splat(minimum);
    for (const whole = rows & ~3; row < whole; row += 4) {
      const code = f32x4.convert_i32x4_u(v128.load(source + (row << 2)));
      v128.store(target + (row << 2), f32x4.add(f32x4.mul(code, steps), minima));
    }
  }
  for (; row < rows; row++) {
    store<f32>(target + ((row * stride) << 2), <f32>load<u32>(source + (row << 2)) * step + minimum);
  }
}

/** Put ±∞ where codes are `levels` and `levels + 1`. */
export function infinities(source: usize, rows: i32, levels: u32, target: usize): void {
  for (let row = 0; row < rows; row++) {
    const code = load<u32>(source + (row << 2));
    if (code >= levels) store<f32>(target + (row << 2), code === levels ? Infinity : -Infinity);
  }
}

/** Values of four byte planes, every `stride` floats; −1 for NaN, too large, or ∞ where not allowed. */
export function floats(planes: usize, rows: i32, infinite: bool, target: usize, stride: i32): i32 {
  const p0 = <usize>load<u32>(planes);
  const p1 = <usize>load<u32>(planes, 4);
  const p2 = <usize>load<u32>(planes, 8);
  const p3 = <usize>load<u32>(planes, 12);
  // Bits of 2^100 and of ∞; magnitudes of floats compare as their bits do.
  const most: u32 = 0x71800000;
  const infinity: u32 = 0x7f800000;
  for (let row = 0; row < rows; row++) {
    const bits =
      <u32>load<u8>(p0 + row) |
      ((<u32>load<u8>(p1 + row)) << 8) |
      ((<u32>load<u8>(p2 + row)) << 16) |
      ((<u32>load<u8>(p3 + row)) << 24);
    const magnitude = bits & 0x7fffffff;
    if (magnitude > most && !(infinite && magnitude === infinity)) return -1;
    store<u32>(target + ((row * stride) << 2), bits);
  }
  return 0;
}

/** −1 where a code is `limit` or more. */
export function below(source: usize, rows: i32, limit: u32): i32 {
  let most: u32 = 0;
  for (let row = 0; row < rows; row++) most = max<u32>(most, load<u32>(source + (row << 2)));
  return rows > 0 && most >= limit ? -1 : 0;
}

/** Fine codes in place of coarse ones; −1 for a bad digit or code. */
export function refineDigits(source: usize, plane: usize, rows: i32, radix: u32, limit: u32): i32 {
  for (let row = 0; row < rows; row++) {
    const digit: u32 = plane ? load<u8>(plane + row) : 0;
    // Coarse codes are below 2^24 and the radix is at most 16, so that this stays below 2^32.
    const code = load<u32>(source + (row << 2)) * radix + digit;
    if (digit >= radix || code >= limit) return -1;
    store<u32>(source + (row << 2), code);
  }
  return 0;
}

/** Scales of differences from the longest axis down. */
export function differences(l: usize, u: usize, v: usize, rows: i32, s0: usize, s1: usize): void {
  let row = 0;
  for (const whole = rows & ~3; row < whole; row += 4) {
    const at = row << 2;
    const first = f32x4.sub(v128.load(l + at), v128.load(u + at));
    const second = f32x4.sub(first, v128.load(v + at));
    v128.store(s0 + at, first);
    v128.store(s1 + at, second);
  }
  for (; row < rows; row++) {
    const at = row << 2;
    const first = load<f32>(l + at) - load<f32>(u + at);
    const second = first - load<f32>(v + at);
    store<f32>(s0 + at, first);
    store<f32>(s1 + at, second);
  }
}

/** Sh0 of coordinates on three axes, in place. */
export function sh0Axes(x: usize, y: usize, z: usize, rows: i32, axes: usize): void {
  // Rows behind the last are computed as well: every reservation has room for a vector more.
  for (let row = 0; row < rows; row += 4) {
    const at = row << 2;
    const a = v128.load(x + at);
    const b = v128.load(y + at);
    const c = v128.load(z + at);
    v128.store(x + at, onAxes(a, b, c, axes));
    v128.store(y + at, onAxes(a, b, c, axes + 4));
    v128.store(z + at, onAxes(a, b, c, axes + 8));
  }
}

function onAxes(a: v128, b: v128, c: v128, axes: usize): v128 {
  return f32x4.add(
    f32x4.add(f32x4.mul(a, v128.load_splat<f32>(axes)), f32x4.mul(b, v128.load_splat<f32>(axes, 12))),
    f32x4.mul(c, v128.load_splat<f32>(axes, 24)),
  );
}

/** f32(a + b), row by row, into a. */
export function add(a: usize, b: usize, rows: i32): void {
  for (let row = 0; row < rows; row += 4) {
    const at = row << 2;
    v128.store(a + at, f32x4.add(v128.load(a + at), v128.load(b + at)));
  }
}

/** Rows of a codebook, and behind its `size` rows of the escape rows, every `stride` floats. */
export function gather(
  codebook: usize,
  escapeRows: usize,
  size: u32,
  indices: usize,
  rows: i32,
  width: i32,
  target: usize,
  stride: i32,
): void {
  for (let row = 0; row < rows; row++) {
    const index = load<u32>(indices + (row << 2));
    const from = index < size ? codebook + ((index * width) << 2) : escapeRows + (((index - size) * width) << 2);
    const to = target + ((row * stride) << 2);
    if (width === 1) {
      store<u32>(to, load<u32>(from));
    } else {
      // 9, 15 and 21 values: whole vectors, then what is left.
      let i = 0;
      for (; i + 4 <= width; i += 4) v128.store(to + (i << 2), v128.load(from + (i << 2)));
      for (; i < width; i++) store<u32>(to + (i << 2), load<u32>(from + (i << 2)));
    }
  }
}

/** Rows of `count` components from columns, whose addresses are u32 at `columns`. */
export function interleave(columns: usize, count: i32, rows: i32, target: usize): void {
  const c0 = <usize>load<u32>(columns);
  if (count === 1) {
    memory.copy(target, c0, (<usize>rows) << 2);
    return;
  }
  const c1 = <usize>load<u32>(columns, 4);
  const c2 = <usize>load<u32>(columns, 8);
  let to = target;
  if (count === 3) {
    for (let row = 0; row < rows; row++, to += 12) {
      const at = row << 2;
      store<u32>(to, load<u32>(c0 + at));
      store<u32>(to, load<u32>(c1 + at), 4);
      store<u32>(to, load<u32>(c2 + at), 8);
    }
    return;
  }
  const c3 = <usize>load<u32>(columns, 12);
  for (let row = 0; row < rows; row++, to += 16) {
    const at = row << 2;
    store<u32>(to, load<u32>(c0 + at));
    store<u32>(to, load<u32>(c1 + at), 4);
    store<u32>(to, load<u32>(c2 + at), 8);
    store<u32>(to, load<u32>(c3 + at), 12);
  }
}
