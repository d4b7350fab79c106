/** Depths are sorted in this many steps: enough that neighbours in one step differ by less than a pixel shows. */
const STEPS = 65_536;

/**
 * Rows from the farthest to the nearest, by counting sort.
 *
 * @param means - Three a row.
 * @param rows - Rows to sort.
 * @param forward - Direction of view.
 * @param order - Receives the rows.
 */
export function sortByDepth(means: Float32Array, rows: number, forward: readonly number[], order: Uint32Array): void {
  const [fx, fy, fz] = forward as [number, number, number];
  const depths = new Float32Array(rows);
  let least = Infinity;
  let most = -Infinity;
  for (let i = 0; i < rows; i++) {
    const depth = means[3 * i]! * fx + means[3 * i + 1]! * fy + means[3 * i + 2]! * fz;
    depths[i] = depth;
    if (depth < least) least = depth;
    if (depth > most) most = depth;
  }
  const scale = most > least ? (STEPS - 1) / (most - least) : 0;
  const starts = new Uint32Array(STEPS + 1);
  const steps = new Uint16Array(rows);
  for (let i = 0; i < rows; i++) {
    const step = Math.floor((most - depths[i]!) * scale);
    steps[i] = step;
    starts[step + 1]!++;
  }
  for (let step = 0; step < STEPS; step++) starts[step + 1]! += starts[step]!;
  for (let i = 0; i < rows; i++) order[starts[steps[i]!]!++] = i;
}
