/** A run of adjacent rows. */
export interface RowRun {
  readonly first: number;
  readonly count: number;
}

/** Allocator of the rows of a layer that holds fewer splats than its scene. */
export class RowSlots {
  /** Free rows, ascending, in runs that do not touch. */
  private free: RowRun[];

  constructor(rows: number) {
    this.free = [{ first: 0, count: rows }];
  }

  /**
   * Allocate the first free rows; adjacent rows form one run.
   *
   * @throws RangeError if fewer than `count` rows are free.
   */
  allocate(count: number): RowRun[] {
    const taken: RowRun[] = [];
    let left = count;
    while (left > 0) {
      const run = this.free.shift();
      if (run === undefined) throw new RangeError(`${count} rows, ${count - left} are free`);
      const used = Math.min(run.count, left);
      taken.push({ first: run.first, count: used });
      if (used < run.count) this.free.unshift({ first: run.first + used, count: run.count - used });
      left -= used;
    }
    return taken;
  }

  /** Make allocated rows free again. */
  release(runs: readonly RowRun[]): void {
    const joined: RowRun[] = [];
    for (const run of [...this.free, ...runs].sort((a, b) => a.first - b.first)) {
      const last = joined.at(-1);
      if (last !== undefined && last.first + last.count === run.first)
        joined[joined.length - 1] = { first: last.first, count: last.count + run.count };
      else joined.push(run);
    }
    this.free = joined;
  }
}
