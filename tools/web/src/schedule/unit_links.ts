/** A segment or unread page that a client may fetch; units of an index are in file order. */
export interface Unit {
  /** Row in `SceneRows` of the chunk or page; −1 for segments of no chunk, for example of codebooks. */
  readonly row: number;
  /** Whether it is the head of the chunk, or the page. */
  readonly isHead: boolean;
  /** Gain for an average picture (docs/streaming.md, 7), in the unit of contributions. */
  readonly gain: number;
  readonly size: number;
  /** Units without which this one is useless: codebooks, and for a head that of the parent chunk. */
  readonly dependencies: readonly number[];
}

/** Looked up once for all decisions: the units of each chunk, its parent, and what depends on each unit. */
export class UnitLinks {
  /** Rows of chunks and unread pages, ascending: parents precede their children. */
  readonly rows: readonly number[];
  /** By row: the unit that is its head. */
  readonly headOf: readonly number[];
  /** By row: row of the chunk on whose head its head depends; −1 for none. */
  readonly parentOf: readonly number[];
  /** By row: its units. */
  readonly unitsOf: readonly (readonly number[])[];
  /** By unit: the units that directly depend on it. */
  readonly dependents: readonly (readonly number[])[];

  constructor(units: readonly Unit[]) {
    const headOf: number[] = [];
    const parentOf: number[] = [];
    const unitsOf: number[][] = [];
    const dependents = units.map((): number[] => []);
    units.forEach(({ row, isHead, dependencies }, unit) => {
      for (const before of dependencies) dependents[before]!.push(unit);
      if (row < 0) return;
      unitsOf[row] ??= [];
      unitsOf[row].push(unit);
      if (!isHead) return;
      headOf[row] = unit;
      parentOf[row] = dependencies.map((before) => units[before]!.row).find((parent) => parent >= 0) ?? -1;
    });
    this.rows = unitsOf.flatMap((_, row) => (headOf[row] === undefined ? [] : [row]));
    this.headOf = headOf;
    this.parentOf = parentOf;
    this.unitsOf = unitsOf;
    this.dependents = dependents;
  }
}
