// Rotations: SPEC 6.6 and 6.11.

const SYMBOL_BITS: i32 = 6;

/** One component of swing and twist; −1 for a code above 2^h. */
export function swingTwist(extra: usize, rows: i32, planes: usize, low: usize, target: usize): i32 {
  let at = 0;
  let bad = 0;
  for (let row = 0; row < rows; row++) {
    const h = <i32>load<u8>(extra + row);
    let value: f32 = 0;
    if (h > 0) {
      const plane = planes + ((min<i32>(h, SYMBOL_BITS) - 1) << 2);
      const from = load<u32>(plane);
      store<u32>(plane, from + 1);
      const e = max<i32>(h - SYMBOL_BITS, 0);
      const rest = (load<u32>(low + (at >> 3)) >>> (at & 7)) & ((1 << e) - 1);
      at += e;
      const code = ((<i32>load<u8>(<usize>from)) << e) | rest;
      bad |= i32(code > 1 << h);
      // 2^(1 − h), exact.
      value = <f32>code * reinterpret<f32>((128 - h) << 23) - 1;
    }
    store<f32>(target + (row << 2), value);
  }
  return -bad;
}

/** Unit quaternions of swing and twist; rows behind the last are computed as well. */
export function swingTwistQuats(a: usize, b: usize, c: usize, rows: i32, targets: usize): void {
  const tw = <usize>load<u32>(targets);
  const tx = <usize>load<u32>(targets, 4);
  const ty = <usize>load<u32>(targets, 8);
  const tz = <usize>load<u32>(targets, 12);
  const one = f32x4.splat(1);
  for (let row = 0; row < rows; row += 4) {
    const at = row << 2;
    const av = v128.load(a + at);
    const bv = v128.load(b + at);
    const z = v128.load(c + at);
    const x = f32x4.add(av, f32x4.mul(bv, z));
    const y = f32x4.sub(bv, f32x4.mul(av, z));
    const norm = f32x4.sqrt(f32x4.add(f32x4.add(f32x4.add(one, f32x4.mul(x, x)), f32x4.mul(y, y)), f32x4.mul(z, z)));
    v128.store(tw + at, f32x4.div(one, norm));
    v128.store(tx + at, f32x4.div(x, norm));
    v128.store(ty + at, f32x4.div(y, norm));
    v128.store(tz + at, f32x4.div(z, norm));
  }
}

/** Unit quaternions of three components. */
export function quats(a: usize, b: usize, c: usize, rows: i32, largest: i32, plane: usize, targets: usize): void {
  const tw = <usize>load<u32>(targets);
  const tx = <usize>load<u32>(targets, 4);
  const ty = <usize>load<u32>(targets, 8);
  const tz = <usize>load<u32>(targets, 12);
  for (let row = 0; row < rows; row++) {
    const at = row << 2;
    const av = load<f32>(a + at);
    const bv = load<f32>(b + at);
    const cv = load<f32>(c + at);
    const left = plane ? <i32>load<u8>(plane + row) : largest;
    const sum: f32 = av * av + bv * bv + cv * cv;
    const rest = sqrt<f32>(max<f32>(1 - sum, 0));
    let w = left === 0 ? rest : av;
    let x = left === 0 ? av : left === 1 ? rest : bv;
    let y = left <= 1 ? bv : left === 2 ? rest : cv;
    let z = left === 3 ? rest : cv;
    const norm = sqrt<f32>(w * w + x * x + y * y + z * z);
    w /= norm;
    x /= norm;
    y /= norm;
    z /= norm;
    const negative = w < 0;
    store<f32>(tw + at, negative ? -w : w);
    store<f32>(tx + at, negative ? -x : x);
    store<f32>(ty + at, negative ? -y : y);
    store<f32>(tz + at, negative ? -z : z);
  }
}
