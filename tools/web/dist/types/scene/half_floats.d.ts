/** The bits of the nearest half float; above the range those of the largest. */
export declare function toHalf(value: number): number;
/** The value of a half float's bits. */
export declare function fromHalf(half: number): number;
