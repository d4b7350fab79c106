/** Bytes as a person reads them: three digits and a unit of 1000. */
export declare function sizeText(bytes: number): string;
/** A CSS colour as R, G, B and opacity from 0 to 1; undefined where it is none. */
export declare function colourOf(text: string): [number, number, number, number] | undefined;
