/** Rows of decoded splats, as SPEC 2.3 has them. */
export interface Splats {
    /** Number of rows. */
    readonly count: number;
    readonly shDegree: number;
    /** Centres, scene units, relative to the scene's origin: 3 a row. */
    readonly means: Float32Array;
    /** Natural logarithms of standard deviations, scene units: 3 a row. */
    readonly scales: Float32Array;
    /** Unit rotations w x y z, w ≥ 0: 4 a row. */
    readonly quats: Float32Array;
    /** Logits; ±∞ mean opacity 1 and 0. */
    readonly opacities: Float32Array;
    /** Coefficients of the DC basis, R G B: 3 a row. */
    readonly sh0: Float32Array;
    /** Coefficients above DC, coefficient by coefficient, channels innermost. */
    readonly shN: Float32Array;
}
/** Coefficients above DC alone. */
export type ShRows = Pick<Splats, "count" | "shDegree" | "shN">;
/** The rows of several scenes of one SH degree, one after the other. */
export declare function concatenate(parts: readonly Splats[], shDegree: number): Splats;
