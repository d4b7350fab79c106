/** What is asked for beyond a round trip, seconds: requests never run dry, and none is made long before. */
const AHEAD_SECONDS = 0.25;
/** What is thrown away must be worth so many times less than what takes its place. */
const EVICT_FACTOR = 2;
/** What is stopped must be worth so many times less than the best that waits. */
const ABORT_FACTOR = 16;

/** A segment that a client may fetch; units stand in the order of the file. */
export interface Unit {
  /** −1 for one that belongs to no chunk, such as a segment of a codebook. */
  readonly chunk: number;
  readonly isHead: boolean;
  /** Byte of the file behind the segment. */
  readonly end: number;
  readonly size: number;
  /** Units that it is of no use without; the head of a chunk names that of its parent. */
  readonly after: readonly number[];
}

/** What a client has, and its means. */
export interface Holdings {
  /** Units that have come. */
  readonly there: ReadonlySet<number>;
  /** Units that are asked for. */
  readonly underWay: ReadonlySet<number>;
  /** Bytes that have come of units that are not whole, under way or stopped. */
  readonly received: ReadonlyMap<number, number>;
  /** Most splats of chunks whose heads are there or under way; 0 for any number. */
  readonly budgetSplats: number;
  /** What the connection is thought to bring. */
  readonly bytesPerSecond: number;
  /** Seconds from a request to its first byte. */
  readonly latency: number;
}

/** What a client does now, in this order. */
export interface Decision {
  /** Units under way that are no longer wanted now; what has come of them stays. */
  readonly stop: readonly number[];
  /** Chunks whose units are thrown away. */
  readonly evict: readonly number[];
  /** Units to ask for, the first first. */
  readonly fetch: readonly number[];
}

/** How many bytes are kept under way, at least (docs/streaming.md, 7). */
export function windowBytes(bytesPerSecond: number, latency: number): number {
  return bytesPerSecond * (latency + AHEAD_SECONDS);
}

/** Decides what to fetch next, what to stop and what to throw away (docs/streaming.md, 7 to 9). */
export class Scheduler {
  private readonly heads = new Map<number, number>();
  /** Ratios of the last decision, and the order that follows from them. */
  private last:
    | { readonly ratios: Float64Array; readonly urgency: Float64Array; readonly order: readonly number[] }
    | undefined;

  constructor(
    private readonly units: readonly Unit[],
    private readonly splats: ArrayLike<number>,
  ) {
    units.forEach(({ chunk, isHead }, at) => {
      if (isHead) this.heads.set(chunk, at);
    });
  }

  /** What a byte of each unit is thought to gain: its chunk's ratio over the square of its place in the file. */
  urgency(ratios: Float64Array): Float64Array {
    return Float64Array.from(this.units, ({ chunk, end }) => (chunk >= 0 ? ratios[chunk]! : 1) / (end * end));
  }

  decide(ratios: Float64Array, holdings: Holdings): Decision {
    const { urgency, order } = this.ordered(ratios);
    const round = new Round(this.units, this.splats, this.heads, urgency, holdings);
    round.stopWhatWaits(order);
    round.makeRoom(Infinity, []);
    while (!round.isFull) {
      const best = round.best(order);
      if (best === undefined) break;
      round.want(best);
    }
    return { stop: round.stopped, evict: round.evicted, fetch: round.chosen };
  }

  /** Urgencies and units by them; ratios that are asked about again are not put in order again. */
  private ordered(ratios: Float64Array): { readonly urgency: Float64Array; readonly order: readonly number[] } {
    if (this.last?.ratios === ratios) return this.last;
    const urgency = this.urgency(ratios);
    const order = this.units.map((_, unit) => unit).sort((a, b) => urgency[b]! - urgency[a]! || a - b);
    this.last = { ratios, urgency, order };
    return this.last;
  }
}

/** Units of which the first is asked for, to have the last: what a byte of them is thought to gain. */
interface Chain {
  readonly units: readonly number[];
  readonly worth: number;
}

/** One decision while it is made. */
class Round {
  readonly stopped: number[] = [];
  readonly evicted: number[] = [];
  readonly chosen: number[] = [];
  private readonly there: Set<number>;
  private readonly coming: Set<number>;
  private readonly received: Map<number, number>;
  private readonly aside = new Set<number>();
  private readonly window: number;
  /** Bytes that are still to come of what is under way. */
  private bytesComing = 0;
  /** Chunks whose heads are held, and their splats; undefined until there is something to make room for. */
  private held: { readonly chunks: Set<number>; splats: number; leastWorth: number | undefined } | undefined;

  constructor(
    private readonly units: readonly Unit[],
    private readonly splats: ArrayLike<number>,
    private readonly heads: ReadonlyMap<number, number>,
    private readonly urgency: Float64Array,
    private readonly holdings: Holdings,
  ) {
    this.there = new Set(holdings.there);
    this.coming = new Set(holdings.underWay);
    this.received = new Map(holdings.received);
    this.window = windowBytes(holdings.bytesPerSecond, holdings.latency);
    for (const unit of this.coming) this.bytesComing += this.left(unit);
  }

  /** Whether as much is under way as the window holds. */
  get isFull(): boolean {
    return this.bytesComing >= this.window && this.coming.size > 0;
  }

  /** The chain to go on with, of units that were not set aside. */
  best(order: readonly number[]): Chain | undefined {
    let best: Chain | undefined;
    for (const unit of order) {
      if (this.isHeld(unit) || this.aside.has(unit)) continue;
      const units = this.needed(unit);
      const worth = units.length === 1 ? this.urgency[unit]! : this.mean(units);
      if (best === undefined || worth > best.worth) best = { units, worth };
      if (units.length === 1) break;
    }
    return best;
  }

  /** The mean urgency of a byte of some units. */
  private mean(units: readonly number[]): number {
    let gain = 0;
    let bytes = 0;
    for (const unit of units) {
      const { size } = this.units[unit]!;
      gain += this.urgency[unit]! * size;
      bytes += size;
    }
    return gain / bytes;
  }

  /** Stop units under way that are worth far less than the best that is not. */
  stopWhatWaits(order: readonly number[]): void {
    const best = this.best(order);
    if (best === undefined) return;
    const { underWay, bytesPerSecond, latency } = this.holdings;
    const worths = this.worths();
    for (const unit of [...underWay].sort((a, b) => worths.get(a)! - worths.get(b)! || b - a)) {
      if (worths.get(unit)! * ABORT_FACTOR >= best.worth) break;
      // What would be here before another answer began is let come.
      if (this.left(unit) / bytesPerSecond <= latency || this.isNeeded(unit)) continue;
      this.leave(unit);
    }
  }

  /** What units under way are worth: as much as anything missing that needs them. */
  private worths(): Map<number, number> {
    const worths = new Map([...this.coming].map((unit) => [unit, this.urgency[unit]!]));
    this.units.forEach((_, unit) => {
      const left = this.isHeld(unit) ? [] : [unit];
      for (let next = left.pop(); next !== undefined; next = left.pop()) {
        for (const before of this.units[next]!.after) {
          left.push(before);
          const worth = worths.get(before);
          if (worth !== undefined) worths.set(before, Math.max(worth, this.urgency[unit]!));
        }
      }
    });
    return worths;
  }

  /** Choose the first unit of a chain, or set the last aside where there is no room for it. */
  want({ units }: Chain): void {
    const first = units[0]!;
    const last = units[units.length - 1]!;
    const { chunk, isHead } = this.units[first]!;
    // What was stopped or thrown away in this decision is not asked for by it again.
    const isGone = units.some((unit) => this.stopped.includes(unit) || this.evicted.includes(this.units[unit]!.chunk));
    if (isGone || (isHead && !this.makeRoom(this.keep(last), units))) {
      this.aside.add(last);
      return;
    }
    if (isHead) this.hold(chunk);
    this.coming.add(first);
    this.bytesComing += this.left(first);
    this.chosen.push(first);
  }

  /** Stop a unit under way. */
  private leave(unit: number): void {
    this.coming.delete(unit);
    this.bytesComing -= this.left(unit);
    this.stopped.push(unit);
  }

  /** What it is worth to keep a unit: room costs the same wherever it stands. */
  private keep(unit: number): number {
    return this.urgency[unit]! * this.units[unit]!.end;
  }

  private left(unit: number): number {
    return this.units[unit]!.size - (this.received.get(unit) ?? 0);
  }

  private isHeld(unit: number): boolean {
    return this.there.has(unit) || this.coming.has(unit);
  }

  /** A unit behind those that are neither there nor coming and that it needs. */
  private needed(unit: number): number[] {
    const out: number[] = [];
    for (const before of this.units[unit]!.after) {
      if (!this.isHeld(before)) out.push(...this.needed(before).filter((other) => !out.includes(other)));
    }
    return [...out, unit];
  }

  /** Whether something that is there or coming is of no use without a unit. */
  private isNeeded(unit: number): boolean {
    return this.units.some(({ after }, other) => after.includes(unit) && this.isHeld(other));
  }

  /**
   * Evict chunks that are worth less until the first head of a chain fits.
   *
   * @param keep - What it is worth to have the chain.
   * @param chain - The first is a head; none for what a budget that was lowered still has room for.
   * @returns False, and nothing is evicted, where not all heads of the chain would fit: a parent that nothing can follow
   * would make room for others again, and so on without end.
   */
  makeRoom(keep: number, chain: readonly number[]): boolean {
    const budget = this.holdings.budgetSplats;
    if (budget === 0) return true;
    this.held ??= this.heldChunks();
    const now = this.held;
    const heads = chain
      .map((unit) => this.units[unit]!)
      .filter(({ isHead }) => isHead)
      .map(({ chunk }) => this.splats[chunk]!);
    const first = heads[0] ?? 0;
    const rows = heads.reduce((sum, count) => sum + count, 0);
    if (now.splats + rows <= budget) return true;
    now.leastWorth ??= [...now.chunks].reduce((least, chunk) => Math.min(least, this.worth(chunk)), Infinity);
    if (!(now.leastWorth * EVICT_FACTOR < keep)) return false;
    const held = new Set(now.chunks);
    let used = now.splats;
    const kept = this.ancestors(chain);
    const going: number[] = [];
    while (used + rows > budget) {
      const chunk = this.least(held, kept, keep);
      if (chunk === undefined) return false;
      held.delete(chunk);
      used -= this.splats[chunk]!;
      going.push(chunk);
    }
    // The other heads take their room when they are asked for.
    for (
      let last = going.at(-1);
      last !== undefined && used + this.splats[last]! + first <= budget;
      last = going.at(-1)
    ) {
      used += this.splats[last]!;
      going.pop();
    }
    for (const chunk of going) this.evict(chunk);
    return true;
  }

  private heldChunks(): { chunks: Set<number>; splats: number; leastWorth: undefined } {
    const chunks = new Set([...this.heads].filter(([, head]) => this.isHeld(head)).map(([chunk]) => chunk));
    let splats = 0;
    for (const chunk of chunks) splats += this.splats[chunk]!;
    return { chunks, splats, leastWorth: undefined };
  }

  private hold(chunk: number): void {
    if (this.held === undefined) return;
    this.held.chunks.add(chunk);
    this.held.splats += this.splats[chunk]!;
    this.held.leastWorth = undefined;
  }

  private evict(chunk: number): void {
    this.evicted.push(chunk);
    this.held = undefined;
    this.units.forEach((part, unit) => {
      if (part.chunk !== chunk) return;
      this.there.delete(unit);
      if (this.coming.has(unit)) this.leave(unit);
      this.received.delete(unit);
    });
  }

  private worth(chunk: number): number {
    return this.keep(this.heads.get(chunk)!);
  }

  /** The chunks of units and of all that these need. */
  private ancestors(chain: readonly number[]): Set<number> {
    const found = new Set<number>();
    const left = [...chain];
    for (let unit = left.pop(); unit !== undefined; unit = left.pop()) {
      const { chunk, after } = this.units[unit]!;
      if (chunk >= 0) found.add(chunk);
      left.push(...after);
    }
    return found;
  }

  /** The chunk to evict first: worth least, parent of none that is held. */
  private least(held: ReadonlySet<number>, kept: ReadonlySet<number>, urgency: number): number | undefined {
    const parents = new Set(
      [...held].flatMap((chunk) => this.units[this.heads.get(chunk)!]!.after.map((unit) => this.units[unit]!.chunk)),
    );
    const chosen = new Set(this.chosen.map((unit) => this.units[unit]!.chunk));
    return [...held]
      .filter(
        (chunk) =>
          !kept.has(chunk) && !parents.has(chunk) && !chosen.has(chunk) && this.worth(chunk) * EVICT_FACTOR < urgency,
      )
      .sort((a, b) => this.worth(a) - this.worth(b) || b - a)[0];
  }
}
