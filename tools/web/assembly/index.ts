// The kernels of src/kernels/kernels.ts in WebAssembly with vectors of 128 bits. Every sum, product and quotient is
// one float32 operation in the order of SPEC.md, so that the results are exact to the bit.

export { unpackDigits } from "./digits";
export {
  add,
  below,
  codes,
  differences,
  floats,
  gather,
  gridValues,
  infinities,
  interleave,
  refineDigits,
  sh0Axes,
} from "./grid";
export { countBits, extraBits, morton, mortonBits, sortedMeans } from "./means";
export { packShn, packSplats } from "./pack";
export { quats, swingTwist, swingTwistQuats } from "./rotations";
export { shnOrder, shnSum, shnValues } from "./shn";
export { zstd } from "./zstd";

/** First byte that the module does not use itself. */
export const heapBase: usize = __heap_base;
