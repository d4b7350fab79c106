/**
 * The arithmetic of SPEC 6 on one block of WebAssembly memory.
 *
 * Functions take addresses: byte offsets into `u8`, multiples of 16 where `alloc` returned them. Address 0 stands for
 * an absent plane. A *column* is one f32 or u32 per row, without gaps. Functions that check their input return 0 for
 * valid data and a negative number otherwise; the caller raises the reason code.
 */
export interface Kernels {
  /** Views of the whole memory. They change when memory grows: read them again after each `alloc`. */
  readonly u8: Uint8Array;
  readonly u32: Uint32Array;
  readonly f32: Float32Array;

  /** Reserve bytes; nothing is said of what they hold. */
  alloc(bytes: number): number;
  /** Where the next reservation would begin. */
  mark(): number;
  /** Give back everything reserved since `mark`. */
  release(mark: number): void;

  /** Decompress one zstd frame whose header and blocks were checked; less or more than `length` bytes give −1. */
  zstd(source: number, sourceLength: number, target: number, length: number): number;
  /** Unpack a plane of symbols below `radix` (SPEC 6.9); −1 for a byte or symbol that cannot be. */
  unpackDigits(source: number, length: number, radix: number, target: number): number;

  /** Codes of 0 to 3 byte planes (SPEC 6.4); −1 for one of `limit` or more. */
  codes(p0: number, p1: number, p2: number, rows: number, limit: number, target: number): number;
  /** Values of codes on a grid (SPEC 6.4), every `stride` floats. */
  gridValues(codes: number, rows: number, step: number, minimum: number, target: number, stride: number): void;
  /** Put ±∞ where codes are `levels` and `levels + 1` (SPEC 6.4). */
  infinities(codes: number, rows: number, levels: number, target: number): void;
  /** Values of four byte planes (SPEC 6.8), every `stride` floats; −1 for NaN, too large, or ∞ where not allowed. */
  floats(planes: number, rows: number, infinite: boolean, target: number, stride: number): number;

  /** Bits that Morton classes stand for (SPEC 6.5); −1 for a class above 51. */
  mortonBits(classes: number, rows: number): number;
  /** Axis codes of Morton differences; −1 for a code of 2^51 or more. */
  morton(classes: number, rows: number, bits: number, x: number, y: number, z: number): number;
  /** −1 where a code is `limit` or more. */
  below(codes: number, rows: number, limit: number): number;

  /** Extra bits of each row, one byte each, from its scales and six coefficients (SPEC 6.10). */
  extraBits(s0: number, s1: number, s2: number, rows: number, coefficients: number, target: number): void;
  /** How many rows have 0, 1, … 15 extra bits: 16 u32. */
  countBits(extra: number, rows: number, target: number): void;
  /**
   * Means of coarse axis codes, extra bits and perhaps refinement bits (SPEC 6.15, 6.17).
   *
   * @param axes - For each axis: step of the grid, minimum; six f32.
   * @param refinement - Bits of a refinement, 0 where there is none; `refinementBits` an axis.
   * @returns −1 for a fine code below 0.
   */
  sortedMeans(
    x: number,
    y: number,
    z: number,
    extra: number,
    rows: number,
    bits: number,
    refinement: number,
    refinementBits: number,
    axes: number,
    targets: number,
  ): number;
  /** One component of swing and twist (SPEC 6.11); `planes` is the address of six u32 addresses; −1 for a bad code. */
  swingTwist(extra: number, rows: number, planes: number, low: number, target: number): number;
  /** Unit quaternions of swing and twist; targets are four u32 addresses. */
  swingTwistQuats(a: number, b: number, c: number, rows: number, targets: number): void;
  /** Unit quaternions of three components (SPEC 6.6); `plane` says which is left out, or `largest` where it is 0. */
  quats(a: number, b: number, c: number, rows: number, largest: number, plane: number, targets: number): void;
  /** Scales of differences (SPEC 6.12): the first two columns; the third is `l` itself. */
  differences(l: number, u: number, v: number, rows: number, s0: number, s1: number): void;
  /** Sh0 of coordinates on three axes (SPEC 6.13): in place; `axes` are nine f32, row by row. */
  sh0Axes(x: number, y: number, z: number, rows: number, axes: number): void;
  /** Fine codes in place of coarse ones (SPEC 6.16); −1 for a bad digit or code. */
  refineDigits(codes: number, plane: number, rows: number, radix: number, limit: number): number;

  /** Rows in the order of falling ends (SPEC 6.14), and how many rows have each end from 0 to `width`. */
  shnOrder(ends: number, rows: number, width: number, order: number, counts: number): number;
  /** Coordinates of `rows` codes; `plus` is 1 for last codes, which are stored less one. */
  shnValues(
    p0: number,
    p1: number,
    p2: number,
    rows: number,
    plus: number,
    step: number,
    shrink: number,
    target: number,
  ): void;
  /**
   * Sum a row's coordinates times the basis (SPEC 6.14).
   *
   * @param order - Rows in the order of falling ends; `counts` as `shnOrder` gives them.
   * @param columns - For each coordinate the address of its values in that order.
   * @param basis - 48 f32 for each coordinate, of which the first `floats` count.
   * @param target - Rows of `floats` f32; what coordinates of no row touch is +0.
   */
  shnSum(
    order: number,
    counts: number,
    width: number,
    columns: number,
    basis: number,
    floats: number,
    target: number,
  ): void;

  /** Rows of a codebook, and behind its `size` rows of the escape rows (SPEC 6.7), every `stride` floats. */
  gather(
    codebook: number,
    escapeRows: number,
    size: number,
    indices: number,
    rows: number,
    floats: number,
    target: number,
    stride: number,
  ): void;
  /** f32(a + b), row by row, into a. */
  add(a: number, b: number, rows: number): void;
  /** Rows of `count` components from columns, whose addresses are u32 at `columns`. */
  interleave(columns: number, count: number, rows: number, target: number): void;

  /**
   * Pack splats for renderers: `columns` are 14 addresses, of means, scales, quats, opacities and sh0; colours from
   * `rgbMin` to `rgbMax` become bytes.
   */
  packSplats(columns: number, rows: number, rgbMin: number, rgbMax: number, target: number): void;
  /** Pack SH bands of rows of 9, 24 or 45 floats; the largest codes stand for `range`. */
  packShn(source: number, rows: number, degree: number, range: number, sh1: number, sh2: number, sh3: number): void;
}
