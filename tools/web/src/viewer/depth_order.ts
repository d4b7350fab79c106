/** Buckets of the radix sort, which takes half of a depth's bits per pass. */
const BUCKETS = 65_536;
/** Rows per step of a sort. */
const STEP_ROWS = 65_536;

/** Plane through the camera, across the direction of view. */
export interface ViewPlane {
  /** Direction of view, of unit length. */
  readonly forward: readonly number[];
  /** Product of the camera's position and the direction. */
  readonly depth: number;
}

/** Memory of a sort, for use in the next one. */
export interface SortMemory {
  /** Depths as float32, then the keys of their order. */
  readonly keys: Float32Array;
  /** Rows ordered by the lower half of their keys. */
  readonly half: Uint32Array;
}

/** Return memory for sorts of a number of rows. */
export function sortMemory(rows: number): SortMemory {
  return { keys: new Float32Array(rows), half: new Uint32Array(rows) };
}

/**
 * Sort rows from the farthest to the nearest by a stable radix sort of their float32 depths, and yield after each
 * millisecond or so.
 *
 * @param means - Three numbers per row.
 * @param rows - Number of rows to sort.
 * @param plane - Zero of the depths: float32 is finest near the camera.
 * @param order - Receives the rows.
 */
export function* sortSteps(
  means: Float32Array,
  rows: number,
  { forward, depth }: ViewPlane,
  order: Uint32Array,
  { keys: depths, half }: SortMemory,
): Generator<void> {
  const [fx, fy, fz] = forward as [number, number, number];
  const keys = new Uint32Array(depths.buffer);
  const low = new Uint32Array(BUCKETS + 1);
  const high = new Uint32Array(BUCKETS + 1);
  for (let first = 0; first < rows; first += STEP_ROWS, yield) {
    const end = Math.min(first + STEP_ROWS, rows);
    for (let i = first; i < end; i++) {
      depths[i] = means[3 * i]! * fx + means[3 * i + 1]! * fy + means[3 * i + 2]! * fz - depth;
      // Bits of negative floats grow with the distance behind; those of positive ones are flipped to sort before them.
      const bits = keys[i]!;
      const key = bits >>> 31 ? bits : bits ^ 0x7fffffff;
      keys[i] = key;
      low[(key & 0xffff) + 1]!++;
      high[(key >>> 16) + 1]!++;
    }
  }
  for (let bucket = 0; bucket < BUCKETS; bucket++) {
    low[bucket + 1]! += low[bucket]!;
    high[bucket + 1]! += high[bucket]!;
  }
  for (let first = 0; first < rows; first += STEP_ROWS, yield) {
    const end = Math.min(first + STEP_ROWS, rows);
    for (let i = first; i < end; i++) half[low[keys[i]! & 0xffff]!++] = i;
  }
  for (let first = 0; first < rows; first += STEP_ROWS, yield) {
    const end = Math.min(first + STEP_ROWS, rows);
    for (let i = first; i < end; i++) {
      const row = half[i]!;
      order[high[keys[row]! >>> 16]!++] = row;
    }
  }
}
