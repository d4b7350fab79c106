const bits = new Uint32Array(1);
const float = new Float32Array(bits.buffer);

/** Return the bits of the nearest half float, at most the largest finite one. */
export function toHalf(value: number): number {
  float[0] = value;
  const sign = (bits[0]! >>> 16) & 0x8000;
  const magnitude = Math.min(Math.abs(value), 65504);
  if (magnitude < 2 ** -14) return sign | Math.round(magnitude * 2 ** 24);
  float[0] = magnitude;
  const word = bits[0]!;
  return sign | ((word + 0xfff + ((word >>> 13) & 1) - 0x38000000) >>> 13);
}

/** Return the value of a half float. */
export function fromHalf(half: number): number {
  const sign = half & 0x8000 ? -1 : 1;
  const exponent = (half >>> 10) & 31;
  const mantissa = half & 0x3ff;
  return sign * (exponent === 0 ? mantissa * 2 ** -24 : (1024 + mantissa) * 2 ** (exponent - 25));
}
