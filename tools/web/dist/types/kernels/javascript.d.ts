import { Arena } from "./arena.js";
import type { Kernels } from "./kernels.js";
/** The arithmetic of SPEC 6 in plain JavaScript, written for reading; the fallback where WebAssembly is not allowed. */
export declare class JavascriptKernels extends Arena implements Kernels {
    readonly backend = "javascript";
    constructor();
    protected grow(bytes: number): ArrayBuffer;
    zstd(source: number, sourceLength: number, target: number, length: number): number;
    unpackDigits(source: number, length: number, radix: number, target: number): number;
    codes(p0: number, p1: number, p2: number, rows: number, limit: number, target: number): number;
    gridValues(codes: number, rows: number, step: number, minimum: number, target: number, stride: number): void;
    infinities(codes: number, rows: number, levels: number, target: number): void;
    floats(planes: number, rows: number, infinite: boolean, target: number, stride: number): number;
    mortonBits(classes: number, rows: number): number;
    morton(classes: number, rows: number, bits: number, x: number, y: number, z: number): number;
    below(codes: number, rows: number, limit: number): number;
    extraBits(s0: number, s1: number, s2: number, rows: number, coefficients: number, target: number): void;
    countBits(extra: number, rows: number, target: number): void;
    sortedMeans(x: number, y: number, z: number, extra: number, rows: number, bits: number, refinement: number, refinementBits: number, axes: number, targets: number): number;
    swingTwist(extra: number, rows: number, planes: number, low: number, target: number): number;
    swingTwistQuats(a: number, b: number, c: number, rows: number, targets: number): void;
    quats(a: number, b: number, c: number, rows: number, largest: number, plane: number, targets: number): void;
    /** Divide by the norm, flip so that w is not below 0, and store. */
    private storeUnit;
    differences(l: number, u: number, v: number, rows: number, s0: number, s1: number): void;
    sh0Axes(x: number, y: number, z: number, rows: number, axes: number): void;
    refineDigits(codes: number, plane: number, rows: number, radix: number, limit: number): number;
    shnOrder(ends: number, rows: number, width: number, order: number, counts: number): number;
    shnValues(p0: number, p1: number, p2: number, rows: number, plus: number, step: number, shrink: number, target: number): void;
    shnSum(order: number, counts: number, rows: number, width: number, columns: number, basis: number, floats: number, target: number): void;
    gather(codebook: number, escape: number, size: number, indices: number, rows: number, floats: number, target: number, stride: number): void;
    add(a: number, b: number, rows: number): void;
    interleave(columns: number, count: number, rows: number, target: number): void;
    packSplats(columns: number, rows: number, rgbMin: number, rgbMax: number, target: number): void;
    packShn(source: number, rows: number, degree: number, range: number, sh1: number, sh2: number, sh3: number): void;
    private column;
    private addresses;
}
/** Symbols below a radix that one byte holds (SPEC 6.9). */
export declare function digitsPerByte(radix: number): number;
