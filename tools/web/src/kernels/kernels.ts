/**
 * The arithmetic of SPEC 6 on one block of WebAssembly memory.
 *
 * Functions take addresses: byte offsets into `u8`, multiples of 16 where `alloc` returned them. Address 0 stands for
 * an absent plane. A *column* is one f32 or u32 per row, without gaps. Functions that check their input return 0 for
 * valid data and a negative number otherwise; the caller raises the reason code.
 */
export interface Kernels {
  /** Views of the whole memory. `alloc` may replace each view, so read it again afterwards. */
  readonly u8: Uint8Array;
  readonly u32: Uint32Array;
  readonly f32: Float32Array;

  /** Reserve bytes with arbitrary contents. */
  alloc(bytes: number): number;
  /** Return the address of the next reservation. */
  mark(): number;
  /** Release all reservations since `mark`. */
  release(mark: number): void;

  /** Decompress one zstd frame whose header and blocks were checked; −1 unless it gives exactly `length` bytes. */
  zstd(source: number, sourceLength: number, target: number, length: number): number;
  /** Unpack a plane of symbols below `radix` (SPEC 6.9); −1 for an invalid byte or symbol. */
  unpackDigits(source: number, length: number, radix: number, target: number): number;

  /** Join 0 to 3 byte planes to codes (SPEC 6.4); −1 for a code of `limit` or more. */
  codes(p0: number, p1: number, p2: number, rows: number, limit: number, target: number): number;
  /** Convert codes to values on a grid (SPEC 6.4), every `stride` floats. */
  gridValues(codes: number, rows: number, step: number, minimum: number, target: number, stride: number): void;
  /** Write ±∞ where codes are `levels` and `levels + 1` (SPEC 6.4). */
  infinities(codes: number, rows: number, levels: number, target: number): void;
  /**
   * Join four byte planes to floats (SPEC 6.8), every `stride` floats; −1 for NaN, a value too large, or a forbidden ∞.
   */
  floats(planes: number, rows: number, infinite: boolean, target: number, stride: number): number;

  /** Return the number of bits of Morton classes (SPEC 6.5); −1 for a class above 51. */
  mortonBits(classes: number, rows: number): number;
  /** Decode Morton differences to axis codes; −1 for a code of 2^51 or more. */
  morton(classes: number, rows: number, bits: number, x: number, y: number, z: number): number;
  /** Check that all codes are below `limit`; −1 otherwise. */
  below(codes: number, rows: number, limit: number): number;

  /** Compute the extra bits of each row, one byte each, from its scales and six coefficients (SPEC 6.10). */
  extraBits(s0: number, s1: number, s2: number, rows: number, coefficients: number, target: number): void;
  /** Count the rows with 0, 1, … 15 extra bits into 16 u32. */
  countBits(extra: number, rows: number, target: number): void;
  /**
   * Compute means from coarse axis codes, extra bits and refinement bits (SPEC 6.15, 6.17).
   *
   * @param axes - Step and minimum of the grid of each axis; six f32.
   * @param refinement - Bits of a refinement, `refinementBits` per axis; 0 for none.
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
  /**
   * Decode one component of swing and twist (SPEC 6.11); `planes` is the address of six u32 addresses; −1 for a bad
   * code.
   */
  swingTwist(extra: number, rows: number, planes: number, low: number, target: number): number;
  /** Convert swing and twist to unit quaternions; `targets` is the address of four u32 addresses. */
  swingTwistQuats(a: number, b: number, c: number, rows: number, targets: number): void;
  /**
   * Complete unit quaternions from three components (SPEC 6.6); `plane` names the omitted one, or `largest` if it is 0.
   */
  quats(a: number, b: number, c: number, rows: number, largest: number, plane: number, targets: number): void;
  /** Convert differences to scales (SPEC 6.12): the first two columns; the third is `l` itself. */
  differences(l: number, u: number, v: number, rows: number, s0: number, s1: number): void;
  /** Convert coordinates on three axes to sh0 (SPEC 6.13), in place; `axes` are nine f32, row by row. */
  sh0Axes(x: number, y: number, z: number, rows: number, axes: number): void;
  /** Replace coarse codes by fine ones (SPEC 6.16); −1 for a bad digit or code. */
  refineDigits(codes: number, plane: number, rows: number, radix: number, limit: number): number;

  /** Order rows by falling end (SPEC 6.14), and count the rows of each end from 0 to `width`. */
  shnOrder(ends: number, rows: number, width: number, order: number, counts: number): number;
  /** Convert codes to coordinates; `plus` is 1 for last codes, which are stored reduced by one. */
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
   * Multiply each row's coordinates by the basis (SPEC 6.14).
   *
   * @param order - Rows by falling end, with `counts`, from `shnOrder`.
   * @param columns - Address of each coordinate's values, in that order.
   * @param basis - 48 f32 per coordinate, of which the first `floats` are used.
   * @param target - Rows of `floats` f32, +0 for rows without coordinates.
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

  /** Gather rows of a codebook, whose `size` rows the escape rows follow (SPEC 6.7), every `stride` floats. */
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
  /** Add columns: a becomes f32(a + b). */
  add(a: number, b: number, rows: number): void;
  /** Interleave columns, whose addresses are u32 at `columns`, into rows of `count` components. */
  interleave(columns: number, count: number, rows: number, target: number): void;

  /**
   * Pack splats for renderers.
   *
   * @param columns - Address of 14 addresses: columns of means, scales, quats, opacities and sh0.
   * @param rgbMin - DC colour of byte 0.
   * @param rgbMax - DC colour of byte 255.
   */
  packSplats(columns: number, rows: number, rgbMin: number, rgbMax: number, target: number): void;
  /** Pack SH bands from rows of 9, 24 or 45 floats; the largest codes stand for `range`. */
  packShn(source: number, rows: number, degree: number, range: number, sh1: number, sh2: number, sh3: number): void;
}
