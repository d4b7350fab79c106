/**
 * Bytes in flight beyond one round trip, as seconds of the connection: requests never run dry, and few are made early.
 */
const AHEAD_SECONDS = 0.25;
/** Factor on the worth of chunks held. Without it, two chunks of similar worth would evict each other in turn. */
const HELD_FACTOR = 2;
/** Least ratio between the urgency of the best missing unit and of a unit stopped for it. */
const ABORT_FACTOR = 16;
/** Time after its eviction for which a chunk is fetched again only if it has become worth more, seconds. */
export const EVICTED_SECONDS = 1;

/** A segment or unread page that a client may fetch; units of an index are in file order. */
export interface Unit {
  /** Row in `SceneRows` of the chunk or page; −1 for segments of no chunk, for example of codebooks. */
  readonly row: number;
  /** Whether it is the head of the chunk, or the page. */
  readonly isHead: boolean;
  /** Place of the unit: in the root the end of the segment in the file, bytes (docs/streaming.md, 7). */
  readonly place: number;
  readonly size: number;
  /** Units without which this one is useless: codebooks, and for a head that of the parent chunk. */
  readonly dependencies: readonly number[];
}

/** State of a client: units, memory and connection. */
export interface Holdings {
  /** Units that have arrived. */
  readonly arrived: ReadonlySet<number>;
  /** Units in flight. */
  readonly inFlight: ReadonlySet<number>;
  /** Bytes received of incomplete units, in flight or stopped. */
  readonly received: ReadonlyMap<number, number>;
  /** Splats of chunks whose heads have arrived or are in flight, at most; 0 for no limit. */
  readonly budgetSplats: number;
  /** Chunks evicted in the last `EVICTED_SECONDS`, with their worth then. */
  readonly evictedWorths: ReadonlyMap<number, number>;
  /** Estimated throughput. */
  readonly bytesPerSecond: number;
  /** Time from a request to its first byte, seconds. */
  readonly latency: number;
}

/** Actions of a client, in this order. */
export interface Decision {
  /** Units in flight to stop; their received bytes are kept. */
  readonly stop: readonly number[];
  /** Chunks to evict, with their worth. */
  readonly evict: ReadonlyMap<number, number>;
  /** Units to request, the most urgent first. */
  readonly fetch: readonly number[];
}

/** Return the number of bytes to keep in flight (docs/streaming.md, 7). */
export function windowBytes(bytesPerSecond: number, latency: number): number {
  return bytesPerSecond * (latency + AHEAD_SECONDS);
}

/** Decides which units to fetch, stop and evict (docs/streaming.md, 7 to 9). */
export class Scheduler {
  private readonly heads = new Map<number, number>();
  /** Urgencies and order for the ratios of the last decision. */
  private last:
    | { readonly ratios: Float64Array; readonly urgency: Float64Array; readonly order: readonly number[] }
    | undefined;

  constructor(
    private readonly units: readonly Unit[],
    private readonly splats: ArrayLike<number>,
  ) {
    units.forEach(({ row, isHead }, at) => {
      if (isHead) this.heads.set(row, at);
    });
  }

  /**
   * Return the estimated gain per byte of each unit: its chunk's ratio, squared if it is below 1, over the square of
   * its place.
   */
  urgency(ratios: Float64Array): Float64Array {
    return Float64Array.from(this.units, ({ row, place }) => {
      const ratio = row >= 0 ? ratios[row]! : 1;
      return (ratio * Math.min(ratio, 1)) / (place * place);
    });
  }

  decide(ratios: Float64Array, holdings: Holdings): Decision {
    const { urgency, order } = this.ordered(ratios);
    const round = new Round(this.units, this.splats, this.heads, urgency, holdings);
    round.makeRoom(0);
    round.stopLessUrgent(order);
    while (!round.isFull) {
      const best = round.best(order);
      if (best === undefined) break;
      round.request(best);
    }
    return { stop: round.stopped, evict: round.evicted, fetch: round.chosen };
  }

  /** Return the urgency and the order of the units, cached for the ratios of the last call. */
  private ordered(ratios: Float64Array): { readonly urgency: Float64Array; readonly order: readonly number[] } {
    if (this.last?.ratios === ratios) return this.last;
    const urgency = this.urgency(ratios);
    const order = this.units.map((_, unit) => unit).sort((a, b) => urgency[b]! - urgency[a]! || a - b);
    this.last = { ratios, urgency, order };
    return this.last;
  }
}

/** A missing unit after its missing dependencies, with its estimated gain per byte. */
interface Chain {
  readonly units: readonly number[];
  readonly worth: number;
}

/** A decision in progress. */
class Round {
  readonly stopped: number[] = [];
  readonly evicted = new Map<number, number>();
  readonly chosen: number[] = [];
  private readonly arrived: Set<number>;
  private readonly inFlight: Set<number>;
  private readonly received: Map<number, number>;
  private readonly skipped = new Set<number>();
  private readonly window: number;
  /** Bytes missing of the units in flight. */
  private bytesInFlight = 0;
  /** Chunks to hold; undefined without a budget. */
  private readonly target: ReadonlySet<number> | undefined;
  /** Other chunks held, in the order of their eviction. */
  private readonly evictable: number[] = [];
  private readonly worths = new Map<number, number>();
  /** Splats of the chunks held. */
  private heldSplats = 0;

  constructor(
    private readonly units: readonly Unit[],
    private readonly splats: ArrayLike<number>,
    private readonly heads: ReadonlyMap<number, number>,
    private readonly urgency: Float64Array,
    private readonly holdings: Holdings,
  ) {
    this.arrived = new Set(holdings.arrived);
    this.inFlight = new Set(holdings.inFlight);
    this.received = new Map(holdings.received);
    this.window = windowBytes(holdings.bytesPerSecond, holdings.latency);
    for (const unit of this.inFlight) this.bytesInFlight += this.missingBytes(unit);
    if (holdings.budgetSplats > 0) this.target = this.chooseTarget(holdings.budgetSplats);
  }

  /** Return the chunks to hold within the budget; list the held chunks to evict (docs/streaming.md, 9). */
  private chooseTarget(budget: number): Set<number> {
    const { worths } = this;
    const parents = new Map<number, number | undefined>();
    for (const [chunk, head] of this.heads) {
      const held = this.isHeld(head);
      if (held) this.heldSplats += this.splats[chunk]!;
      worths.set(chunk, this.urgency[head]! * this.units[head]!.place * (held ? HELD_FACTOR : 1));
      parents.set(
        chunk,
        this.units[head]!.dependencies.map((unit) => this.units[unit]!.row).find((parent) => parent >= 0),
      );
    }
    // Parents precede their children.
    for (const chunk of [...worths.keys()].sort((a, b) => b - a)) {
      const parent = parents.get(chunk);
      if (parent !== undefined) worths.set(parent, Math.max(worths.get(parent)!, worths.get(chunk)!));
    }
    const order = [...worths.keys()].sort((a, b) => worths.get(b)! - worths.get(a)! || a - b);
    const target = new Set<number>();
    let room = budget;
    for (const chunk of order) {
      const parent = parents.get(chunk);
      if ((parent !== undefined && !target.has(parent)) || this.splats[chunk]! > room) continue;
      if (!this.isHeld(this.heads.get(chunk)!) && worths.get(chunk)! < (this.holdings.evictedWorths.get(chunk) ?? 0))
        continue;
      target.add(chunk);
      room -= this.splats[chunk]!;
    }
    this.evictable.push(
      ...order.reverse().filter((chunk) => !target.has(chunk) && this.isHeld(this.heads.get(chunk)!)),
    );
    return target;
  }

  /** Whether the bytes in flight fill the window. */
  get isFull(): boolean {
    return this.bytesInFlight >= this.window && this.inFlight.size > 0;
  }

  /** Return the most urgent chain, without units skipped in this decision. */
  best(order: readonly number[]): Chain | undefined {
    let best: Chain | undefined;
    for (const unit of order) {
      if (!this.isWanted(unit) || this.skipped.has(unit)) continue;
      const units = this.withDependencies(unit);
      const worth = units.length === 1 ? this.urgency[unit]! : this.mean(units);
      if (best === undefined || worth > best.worth) best = { units, worth };
      if (units.length === 1) break;
    }
    return best;
  }

  /** Return the mean urgency per byte of some units. */
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

  /** Stop units in flight that are far less urgent than the best missing chain. */
  stopLessUrgent(order: readonly number[]): void {
    const best = this.best(order);
    if (best === undefined) return;
    const { bytesPerSecond, latency } = this.holdings;
    const worths = this.worthsInFlight();
    for (const unit of [...this.inFlight].sort((a, b) => worths.get(a)! - worths.get(b)! || b - a)) {
      if (worths.get(unit)! * ABORT_FACTOR >= best.worth) break;
      // A unit that would arrive before another answer could begin is kept.
      if (this.missingBytes(unit) / bytesPerSecond <= latency || this.hasDependents(unit)) continue;
      this.stop(unit);
    }
  }

  /** Return the worth of each unit in flight: the urgency of the most urgent missing unit that depends on it. */
  private worthsInFlight(): Map<number, number> {
    const worths = new Map([...this.inFlight].map((unit) => [unit, this.urgency[unit]!]));
    this.units.forEach((_, unit) => {
      const left = this.isHeld(unit) ? [] : [unit];
      for (let next = left.pop(); next !== undefined; next = left.pop()) {
        for (const before of this.units[next]!.dependencies) {
          left.push(before);
          const worth = worths.get(before);
          if (worth !== undefined) worths.set(before, Math.max(worth, this.urgency[unit]!));
        }
      }
    });
    return worths;
  }

  /** Request the first unit of a chain, after evictions for a head without room. */
  request({ units }: Chain): void {
    const first = units[0]!;
    // A decision does not request again what it stops.
    if (units.some((unit) => this.stopped.includes(unit))) {
      this.skipped.add(units[units.length - 1]!);
      return;
    }
    const { row, isHead } = this.units[first]!;
    if (isHead) {
      this.makeRoom(this.splats[row]!);
      this.heldSplats += this.splats[row]!;
    }
    this.inFlight.add(first);
    this.bytesInFlight += this.missingBytes(first);
    this.chosen.push(first);
  }

  /** Stop a unit in flight. */
  private stop(unit: number): void {
    const { row, isHead } = this.units[unit]!;
    this.inFlight.delete(unit);
    this.bytesInFlight -= this.missingBytes(unit);
    this.stopped.push(unit);
    if (isHead) this.heldSplats -= this.splats[row]!;
  }

  /**
   * Evict chunks outside the target until `splats` more splats fit the budget.
   *
   * @param splats - Splats of the next chunk of the target; 0 to enforce a lowered budget.
   */
  makeRoom(splats: number): void {
    while (this.evictable.length > 0 && this.heldSplats + splats > this.holdings.budgetSplats) {
      const chunk = this.evictable.shift()!;
      // A head in flight may have been stopped.
      if (this.isHeld(this.heads.get(chunk)!)) this.evict(chunk);
    }
  }

  private evict(chunk: number): void {
    this.evicted.set(chunk, this.worths.get(chunk)!);
    this.units.forEach((part, unit) => {
      if (part.row !== chunk) return;
      if (this.inFlight.has(unit)) this.stop(unit);
      else if (this.arrived.delete(unit) && part.isHead) this.heldSplats -= this.splats[chunk]!;
      this.received.delete(unit);
    });
  }

  private missingBytes(unit: number): number {
    return this.units[unit]!.size - (this.received.get(unit) ?? 0);
  }

  private isHeld(unit: number): boolean {
    return this.arrived.has(unit) || this.inFlight.has(unit);
  }

  /** Return whether a unit is missing, and of a chunk to hold or of none. */
  private isWanted(unit: number): boolean {
    const { row } = this.units[unit]!;
    return !this.isHeld(unit) && (row < 0 || this.target === undefined || this.target.has(row));
  }

  /** Return the missing dependencies of a unit, then the unit. */
  private withDependencies(unit: number): number[] {
    const out: number[] = [];
    for (const before of this.units[unit]!.dependencies) {
      if (!this.isHeld(before)) out.push(...this.withDependencies(before).filter((other) => !out.includes(other)));
    }
    return [...out, unit];
  }

  /** Return whether a unit that has arrived or is in flight depends on this one. */
  private hasDependents(unit: number): boolean {
    return this.units.some(({ dependencies }, other) => dependencies.includes(unit) && this.isHeld(other));
  }
}
