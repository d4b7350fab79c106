/** Rows of decoded splats (SPEC 2.3). */
export interface Splats {
  /** Number of rows. */
  readonly count: number;
  readonly shDegree: number;
  /** Centres, scene units, relative to the scene's origin: 3 per row. */
  readonly means: Float32Array;
  /** Natural logarithms of standard deviations, scene units: 3 per row. */
  readonly scales: Float32Array;
  /** Unit quaternions w x y z, w ≥ 0: 4 per row. */
  readonly quats: Float32Array;
  /** Logits; ±∞ for opacities of 1 and 0. */
  readonly opacities: Float32Array;
  /** Coefficients of the DC basis, R G B: 3 per row. */
  readonly sh0: Float32Array;
  /** Coefficients above DC, coefficient by coefficient, channels innermost. */
  readonly shN: Float32Array;
}

/** Concatenate the rows of several parts of one SH degree. */
export function concatenate(parts: readonly Splats[], shDegree: number): Splats {
  const join = (arrays: Float32Array[]) => {
    const joined = new Float32Array(arrays.reduce((sum, array) => sum + array.length, 0));
    let at = 0;
    for (const array of arrays) {
      joined.set(array, at);
      at += array.length;
    }
    return joined;
  };
  return {
    count: parts.reduce((sum, part) => sum + part.count, 0),
    shDegree,
    means: join(parts.map((part) => part.means)),
    scales: join(parts.map((part) => part.scales)),
    quats: join(parts.map((part) => part.quats)),
    opacities: join(parts.map((part) => part.opacities)),
    sh0: join(parts.map((part) => part.sh0)),
    shN: join(parts.map((part) => part.shN)),
  };
}
