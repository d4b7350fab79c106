import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { readPlane } from "./planes.js";
import { checkPlanes, type StreamRecord } from "./records.js";
import { addressTable } from "./step_model.js";

/** Length of the parameters before the sizes, bytes (SPEC 6.14). */
const FIXED_PARAMS = 16;
/** First coordinate of each group: 0 to 7 alone, then 8–11, 12–17, 18–25 and 26–254 (SPEC 6.14). */
const GROUP_STARTS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 18, 26, 255] as const;
const MAX_WIDTH = 255;
const MAX_STEP = 2 ** 32;
const MAX_ENTRY = 2 ** 32;
/** Stride of the basis rows in the kernels' memory, floats: 45, padded to whole vectors. */
export const BASIS_STRIDE = 48;

/** Parameters of a basis stream of shN. */
export interface ShnBasisParams {
  readonly step: number;
  readonly shrink: number;
  readonly width: number;
  /** Bytes of the inner codes and of the last codes of each group. */
  readonly sizes: readonly (readonly [number, number])[];
}

/** Coordinates of shN on its basis, in the layout of the kernels. */
export interface ShnCoordinates {
  /** Address of the rows ordered by falling end; see `Kernels.shnOrder` for `counts`. */
  readonly order: number;
  readonly counts: number;
  readonly columns: number;
  readonly width: number;
}

/** Check the length of the parameters of a basis stream of shN, and return its codebook (SPEC 6.14). */
export function readShnCodebook({ params }: StreamRecord): number {
  const groups = params.byteLength < FIXED_PARAMS ? 0 : groupsOf(params.getUint16(12, true));
  if (params.byteLength !== FIXED_PARAMS + 2 * groups) {
    throw new CogsplatError("stream-params", `shN: ${params.byteLength} bytes of parameters`);
  }
  return params.getUint32(0, true);
}

/**
 * Read the parameters of a basis stream of shN after its codebook (SPEC 6.14).
 *
 * @param bookRows - Rows of the codebook that the stream names.
 */
export function readShnParams({ params }: StreamRecord, bookRows: number): ShnBasisParams {
  const step = params.getFloat32(4, true);
  const shrink = params.getFloat32(8, true);
  const width = params.getUint16(12, true);
  if (width > Math.min(MAX_WIDTH, bookRows) || params.getUint16(14, true) !== 0) {
    throw new CogsplatError("basis-width", `${width} coordinates on ${bookRows} rows, or reserved bytes that are set`);
  }
  if (!(step > 0 && step <= MAX_STEP && shrink >= 0 && shrink <= 0.5)) {
    throw new CogsplatError("basis-value", `shN on a basis in steps of ${step} with a shrink of ${shrink}`);
  }
  const sizes = Array.from({ length: groupsOf(width) }, (_, g) => {
    return [params.getUint8(FIXED_PARAMS + 2 * g), params.getUint8(FIXED_PARAMS + 2 * g + 1)] as const;
  });
  return { step, shrink, width, sizes };
}

/** Return the number of groups of the coordinates below a width. */
function groupsOf(width: number): number {
  return GROUP_STARTS.slice(0, -1).filter((start) => start < width).length;
}

/**
 * Read the coordinates of every row (SPEC 6.14).
 *
 * Coordinate j of the rows, ordered by falling end, is one column: the inner codes of the rows that end after j + 1,
 * then the last codes of the rows that end there.
 */
export function readShnCoordinates(k: Kernels, stream: StreamRecord, params: ShnBasisParams): ShnCoordinates {
  const { rows } = stream;
  const { width, sizes, step, shrink } = params;
  if (sizes.some(([inner, last]) => inner > 3 || last > 3)) {
    throw new CogsplatError("stream-planes", "a code of shN of more than 3 bytes");
  }
  checkPlanes(stream, 1 + sizes.reduce((sum, [inner, last]) => sum + inner + last, 0));
  const ends = readPlane(k, stream.planes[0]!, rows);
  const order = k.alloc(4 * rows);
  const counts = k.alloc(4 * (width + 1));
  if (k.shnOrder(ends, rows, width, order, counts) !== 0) {
    throw new CogsplatError("code-range", `a row of shN that ends behind coordinate ${width}`);
  }
  const endCounts = k.u32.slice(counts >>> 2, (counts >>> 2) + width + 1);
  // Number of rows that end after coordinate j, at j + 1 or later.
  const beyond = new Uint32Array(width + 1);
  for (let j = width - 1; j >= 0; j--) beyond[j] = beyond[j + 1]! + endCounts[j + 1]!;
  const columns = Array.from({ length: width }, (_, j) => k.alloc(4 * beyond[j]!));
  let next = 1;
  sizes.forEach((size, g) => {
    const group: number[] = [];
    for (let j = GROUP_STARTS[g]!; j < Math.min(GROUP_STARTS[g + 1]!, width); j++) group.push(j);
    for (const last of [0, 1] as const) {
      const lengths = group.map((j) => (last === 1 ? endCounts[j + 1]! : beyond[j + 1]!));
      const total = lengths.reduce((sum, length) => sum + length, 0);
      const planes = stream.planes.slice(next, next + size[last]).map((plane) => readPlane(k, plane, total));
      next += size[last];
      let at = 0;
      group.forEach((j, i) => {
        const [p0, p1, p2] = [0, 1, 2].map((byte) => (byte < planes.length ? planes[byte]! + at : 0)) as [
          number,
          number,
          number,
        ];
        const target = columns[j]! + (last === 1 ? 4 * beyond[j + 1]! : 0);
        k.shnValues(p0, p1, p2, lengths[i]!, last, step, shrink, target);
        at += lengths[i]!;
      });
    }
  });
  return { order, counts, columns: addressTable(k, columns), width };
}

/** Refuse a basis with entries that are too large (SPEC 6.14). */
export function checkBasisEntries(entries: Float32Array): void {
  if (entries.some((entry) => !(Math.abs(entry) <= MAX_ENTRY))) {
    throw new CogsplatError("basis-value", "an entry of a basis above 2^32 in magnitude");
  }
}
