/** Pack rows of 14 columns: means, scales, quats, opacities, sh0. */
export declare function packSplats(columns: readonly Float32Array[], rows: number, rgbMin: number, rgbMax: number, target: Uint32Array): void;
/**
 * Pack one SH band of every row.
 *
 * @param source - Rows of `stride` floats, the band's first at `first`.
 * @param bits - Bits of a value in two's complement, whose largest stands for `range`.
 * @param words - Words of a row in `target`.
 */
export declare function packBand(source: Float32Array, rows: number, stride: number, first: number, count: number, bits: number, range: number, words: number, target: Uint32Array): void;
