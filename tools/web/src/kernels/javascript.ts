import { Arena } from "./arena.js";
import { BitReader } from "./bit_reader.js";
import { packBand, packSplats } from "./javascript_packing.js";
import type { Kernels } from "./kernels.js";
import { decompressFrame } from "./zstd.js";

const f32 = Math.fround;
/** Magnitudes of float streams are at most this (SPEC 6.8). */
const MAX_MAGNITUDE = 2 ** 100;
/** Most bits of a Morton code: 17 for each axis (SPEC 6.5). */
const MAX_CLASS = 51;

/** The arithmetic of SPEC 6 in plain JavaScript, written for reading; the fallback where WebAssembly is not allowed. */
export class JavascriptKernels extends Arena implements Kernels {
  readonly backend = "javascript";

  constructor() {
    super(new ArrayBuffer(1 << 20), 16);
  }

  protected override grow(bytes: number): ArrayBuffer {
    const larger = new Uint8Array(Math.max(bytes, 2 * this.u8.length));
    larger.set(this.u8);
    return larger.buffer;
  }

  zstd(source: number, sourceLength: number, target: number, length: number): number {
    const frame = this.u8.subarray(source, source + sourceLength);
    return decompressFrame(frame, this.u8.subarray(target, target + length)) ? 0 : -1;
  }

  unpackDigits(source: number, length: number, radix: number, target: number): number {
    const perByte = digitsPerByte(radix);
    const bytes = Math.ceil(length / perByte);
    const limit = radix ** perByte;
    for (let i = 0; i < bytes; i++) {
      let rest = this.u8[source + i]!;
      if (rest >= limit) return -1;
      const end = Math.min(length, (i + 1) * perByte);
      for (let j = i * perByte; j < end; j++) {
        this.u8[target + j] = rest % radix;
        rest = Math.floor(rest / radix);
      }
      if (rest !== 0) return -1;
    }
    return 0;
  }

  codes(p0: number, p1: number, p2: number, rows: number, limit: number, target: number): number {
    const { u8, u32 } = this;
    const to = target >>> 2;
    for (let row = 0; row < rows; row++) {
      const code = (p0 && u8[p0 + row]!) | (p1 && u8[p1 + row]! << 8) | (p2 && u8[p2 + row]! << 16);
      if (code >= limit) return -1;
      u32[to + row] = code;
    }
    return 0;
  }

  gridValues(codes: number, rows: number, step: number, minimum: number, target: number, stride: number): void {
    const from = codes >>> 2;
    const to = target >>> 2;
    for (let row = 0; row < rows; row++) {
      this.f32[to + row * stride] = f32(f32(this.u32[from + row]! * step) + minimum);
    }
  }

  infinities(codes: number, rows: number, levels: number, target: number): void {
    for (let row = 0; row < rows; row++) {
      const code = this.u32[(codes >>> 2) + row]!;
      if (code >= levels) this.f32[(target >>> 2) + row] = code === levels ? Infinity : -Infinity;
    }
  }

  floats(planes: number, rows: number, infinite: boolean, target: number, stride: number): number {
    const [p0, p1, p2, p3] = this.addresses(planes, 4) as [number, number, number, number];
    const { u8 } = this;
    for (let row = 0; row < rows; row++) {
      const at = (target >>> 2) + row * stride;
      this.u32[at] = u8[p0 + row]! | (u8[p1 + row]! << 8) | (u8[p2 + row]! << 16) | (u8[p3 + row]! << 24);
      const magnitude = Math.abs(this.f32[at]!);
      if (!(magnitude <= MAX_MAGNITUDE || (infinite && magnitude === Infinity))) return -1;
    }
    return 0;
  }

  mortonBits(classes: number, rows: number): number {
    let bits = 0;
    for (let row = 0; row < rows; row++) {
      const bitLength = this.u8[classes + row]!;
      if (bitLength > MAX_CLASS) return -1;
      bits += Math.max(bitLength - 1, 0);
    }
    return bits;
  }

  morton(classes: number, rows: number, bits: number, x: number, y: number, z: number): number {
    const reader = new BitReader(this.u8, bits);
    let code = 0; // below 2^52, so a double holds it exactly
    for (let row = 0; row < rows; row++) {
      const bitLength = this.u8[classes + row]!;
      if (bitLength > 0) code += 2 ** (bitLength - 1) + reader.take(bitLength - 1);
      if (code >= 2 ** MAX_CLASS) return -1;
      // 27 bits are nine of each axis.
      const high = Math.floor(code / 2 ** 27);
      const low = code - high * 2 ** 27;
      for (const [axis, target] of [x, y, z].entries()) {
        this.u32[(target >>> 2) + row] = everyThird(low, axis) | (everyThird(high, axis) << 9);
      }
    }
    return 0;
  }

  below(codes: number, rows: number, limit: number): number {
    for (let row = 0; row < rows; row++) if (this.u32[(codes >>> 2) + row]! >= limit) return -1;
    return 0;
  }

  extraBits(s0: number, s1: number, s2: number, rows: number, coefficients: number, target: number): void {
    const c = this.column(coefficients, 6);
    const [m, t, l] = [this.column(s0, rows), this.column(s1, rows), this.column(s2, rows)];
    for (let row = 0; row < rows; row++) {
      const p = f32(l[row]! - m[row]!);
      const q = f32(m[row]! - t[row]!);
      let sum = c[0]!;
      sum = f32(sum + f32(c[1]! * l[row]!));
      sum = f32(sum + f32(c[2]! * Math.min(p, 1.5)));
      sum = f32(sum + f32(c[3]! * Math.min(p, 5)));
      sum = f32(sum + f32(c[4]! * Math.min(q, 0.5)));
      sum = f32(sum + f32(c[5]! * Math.min(q, 3)));
      this.u8[target + row] = Math.min(Math.max(Math.floor(sum), 0), 15);
    }
  }

  countBits(extra: number, rows: number, target: number): void {
    const counts = this.u32.subarray(target >>> 2, (target >>> 2) + 16).fill(0);
    for (let row = 0; row < rows; row++) counts[this.u8[extra + row]!]!++;
  }

  sortedMeans(
    x: number, y: number, z: number, extra: number, rows: number, bits: number,
    refinement: number, refinementBits: number, axes: number, targets: number,
  ): number {
    const reader = new BitReader(this.u8, bits);
    const refined = new BitReader(this.u8, refinement);
    const grid = this.column(axes, 6);
    const to = this.addresses(targets, 3);
    for (let row = 0; row < rows; row++) {
      const h = this.u8[extra + row]!;
      for (const [axis, codes] of [x, y, z].entries()) {
        let code = this.u32[(codes >>> 2) + row]! * 2 ** h + reader.take(h);
        if (refinementBits > 0) {
          code = code * 2 ** refinementBits + refined.take(refinementBits) - 2 ** (refinementBits - 1);
          if (code < 0) return -1;
        }
        const step = f32(grid[2 * axis]! * 2 ** -(h + refinementBits));
        this.f32[(to[axis]! >>> 2) + row] = f32(f32(f32(code) * step) + grid[2 * axis + 1]!);
      }
    }
    return 0;
  }

  swingTwist(extra: number, rows: number, planes: number, low: number, target: number): number {
    const symbols = this.addresses(planes, 6);
    const reader = new BitReader(this.u8, low);
    for (let row = 0; row < rows; row++) {
      const h = this.u8[extra + row]!;
      let value = 0;
      if (h > 0) {
        const high = Math.min(h, 6) - 1;
        const e = Math.max(h - 6, 0);
        const code = this.u8[symbols[high]!++]! * 2 ** e + reader.take(e);
        if (code > 2 ** h) return -1;
        value = f32(f32(code * 2 ** (1 - h)) - 1);
      }
      this.f32[(target >>> 2) + row] = value;
    }
    return 0;
  }

  swingTwistQuats(a: number, b: number, c: number, rows: number, targets: number): void {
    const [as, bs, cs] = [this.column(a, rows), this.column(b, rows), this.column(c, rows)];
    const to = this.addresses(targets, 4);
    for (let row = 0; row < rows; row++) {
      const [ar, br, cr] = [as[row]!, bs[row]!, cs[row]!];
      this.storeUnit(to, row, 1, f32(ar + f32(br * cr)), f32(br - f32(ar * cr)), cr);
    }
  }

  quats(a: number, b: number, c: number, rows: number, largest: number, plane: number, targets: number): void {
    const [as, bs, cs] = [this.column(a, rows), this.column(b, rows), this.column(c, rows)];
    const to = this.addresses(targets, 4);
    for (let row = 0; row < rows; row++) {
      const [ar, br, cr] = [as[row]!, bs[row]!, cs[row]!];
      const left = plane ? this.u8[plane + row]! : largest;
      const rest = f32(1 - f32(f32(f32(ar * ar) + f32(br * br)) + f32(cr * cr)));
      const quat = [ar, br, cr];
      quat.splice(left, 0, f32(Math.sqrt(Math.max(rest, 0))));
      this.storeUnit(to, row, quat[0]!, quat[1]!, quat[2]!, quat[3]!);
    }
  }

  /** Divide by the norm, flip so that w is not below 0, and store. */
  private storeUnit(targets: readonly number[], row: number, w: number, x: number, y: number, z: number): void {
    const norm = f32(Math.sqrt(f32(f32(f32(f32(w * w) + f32(x * x)) + f32(y * y)) + f32(z * z))));
    const unit = [f32(w / norm), f32(x / norm), f32(y / norm), f32(z / norm)];
    const sign = unit[0]! < 0 ? -1 : 1;
    unit.forEach((value, i) => (this.f32[(targets[i]! >>> 2) + row] = value * sign));
  }

  differences(l: number, u: number, v: number, rows: number, s0: number, s1: number): void {
    const [ls, us, vs] = [this.column(l, rows), this.column(u, rows), this.column(v, rows)];
    for (let row = 0; row < rows; row++) {
      const first = f32(ls[row]! - us[row]!);
      const second = f32(first - vs[row]!);
      this.f32[(s0 >>> 2) + row] = first;
      this.f32[(s1 >>> 2) + row] = second;
    }
  }

  sh0Axes(x: number, y: number, z: number, rows: number, axes: number): void {
    const columns = [this.column(x, rows), this.column(y, rows), this.column(z, rows)] as const;
    const axis = this.column(axes, 9);
    for (let row = 0; row < rows; row++) {
      const [xr, yr, zr] = [columns[0][row]!, columns[1][row]!, columns[2][row]!];
      for (let c = 0; c < 3; c++) {
        columns[c]![row] = f32(f32(f32(xr * axis[c]!) + f32(yr * axis[3 + c]!)) + f32(zr * axis[6 + c]!));
      }
    }
  }

  refineDigits(codes: number, plane: number, rows: number, radix: number, limit: number): number {
    for (let row = 0; row < rows; row++) {
      const digit = plane ? this.u8[plane + row]! : 0;
      const code = this.u32[(codes >>> 2) + row]! * radix + digit;
      if (digit >= radix || code >= limit) return -1;
      this.u32[(codes >>> 2) + row] = code;
    }
    return 0;
  }

  shnOrder(ends: number, rows: number, width: number, order: number, counts: number): number {
    const count = this.u32.subarray(counts >>> 2, (counts >>> 2) + width + 1).fill(0);
    for (let row = 0; row < rows; row++) {
      const end = this.u8[ends + row]!;
      if (end > width) return -1;
      count[end]!++;
    }
    const next = new Uint32Array(width + 1);
    for (let end = width; end > 0; end--) next[end - 1] = next[end]! + count[end]!;
    for (let row = 0; row < rows; row++) this.u32[(order >>> 2) + next[this.u8[ends + row]!]!++] = row;
    return 0;
  }

  shnValues(
    p0: number, p1: number, p2: number, rows: number, plus: number, step: number, shrink: number, target: number,
  ): void {
    const { u8 } = this;
    for (let i = 0; i < rows; i++) {
      const k = ((p0 && u8[p0 + i]!) | (p1 && u8[p1 + i]! << 8) | (p2 && u8[p2 + i]! << 16)) + plus;
      const magnitude = f32(f32(Math.floor((k + 1) / 2) - shrink) * step);
      this.f32[(target >>> 2) + i] = k === 0 ? 0 : k % 2 === 0 ? -magnitude : magnitude;
    }
  }

  shnSum(
    order: number, counts: number, rows: number, width: number, columns: number, basis: number, floats: number,
    target: number,
  ): void {
    const values = this.addresses(columns, width).map((address) => address >>> 2);
    let at = 0;
    for (let end = width; end >= 0; end--) {
      const last = at + this.u32[(counts >>> 2) + end]!;
      for (; at < last; at++) {
        const to = (target >>> 2) + this.u32[(order >>> 2) + at]! * floats;
        this.f32.fill(0, to, to + floats);
        for (let j = 0; j < end; j++) {
          const v = this.f32[values[j]! + at]!;
          if (v === 0) continue;
          const row = (basis >>> 2) + 48 * j;
          for (let i = 0; i < floats; i++) this.f32[to + i] = f32(this.f32[to + i]! + f32(v * this.f32[row + i]!));
        }
      }
    }
    if (at !== rows) throw new RangeError(`ends of ${at} rows in the place of ${rows}`);
  }

  gather(
    codebook: number, escape: number, size: number, indices: number, rows: number, floats: number, target: number,
    stride: number,
  ): void {
    for (let row = 0; row < rows; row++) {
      const index = this.u32[(indices >>> 2) + row]!;
      const from = index < size ? (codebook >>> 2) + index * floats : (escape >>> 2) + (index - size) * floats;
      this.f32.copyWithin((target >>> 2) + row * stride, from, from + floats);
    }
  }

  add(a: number, b: number, rows: number): void {
    for (let row = 0; row < rows; row++) this.f32[(a >>> 2) + row]! += this.f32[(b >>> 2) + row]!;
  }

  interleave(columns: number, count: number, rows: number, target: number): void {
    this.addresses(columns, count).forEach((column, i) => {
      for (let row = 0; row < rows; row++) {
        this.u32[(target >>> 2) + row * count + i] = this.u32[(column >>> 2) + row]!;
      }
    });
  }

  packSplats(columns: number, rows: number, rgbMin: number, rgbMax: number, target: number): void {
    const values = this.addresses(columns, 14).map((address) => this.column(address, rows));
    packSplats(values, rows, rgbMin, rgbMax, this.u32.subarray(target >>> 2));
  }

  packShn(
    source: number, rows: number, degree: number, range: number, sh1: number, sh2: number, sh3: number,
  ): void {
    const stride = 3 * ((degree + 1) ** 2 - 1);
    const from = this.f32.subarray(source >>> 2);
    packBand(from, rows, stride, 0, 9, 7, range, 2, this.u32.subarray(sh1 >>> 2));
    if (degree > 1) packBand(from, rows, stride, 9, 15, 8, range, 4, this.u32.subarray(sh2 >>> 2));
    if (degree > 2) packBand(from, rows, stride, 24, 21, 6, range, 4, this.u32.subarray(sh3 >>> 2));
  }

  private column(address: number, rows: number): Float32Array {
    return this.f32.subarray(address >>> 2, (address >>> 2) + rows);
  }

  private addresses(table: number, count: number): number[] {
    return Array.from(this.u32.subarray(table >>> 2, (table >>> 2) + count));
  }
}

/** Symbols below a radix that one byte holds (SPEC 6.9). */
export function digitsPerByte(radix: number): number {
  let count = 1;
  while (radix ** (count + 1) <= 256) count++;
  return count;
}

/** Bits `axis`, `axis + 3`, … of 27 bits, together. */
function everyThird(bits: number, axis: number): number {
  let value = 0;
  for (let i = 0; i < 9; i++) value |= ((bits >>> (3 * i + axis)) & 1) << i;
  return value;
}
