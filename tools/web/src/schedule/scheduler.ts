import { type Unit, UnitLinks } from "./unit_links.js";

/**
 * Bytes in flight beyond bandwidth times latency, as seconds of the connection. More would be chosen before the pages
 * and view tables have arrived that tell what is visible; less would let the connection run idle.
 */
const AHEAD_SECONDS = 0.1;
/** Factor on the worth of chunks held. Without it, two chunks of similar worth would evict each other in turn. */
const HELD_FACTOR = 2;
/** Least ratio between the urgency of the best missing unit and of a unit stopped for it. */
const ABORT_FACTOR = 16;
/** Time after its eviction for which a chunk is fetched again only if its worth has doubled, seconds. */
export const EVICTED_SECONDS = 1;

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
  private readonly links: UnitLinks;
  /** Rows of the chunks by falling worth in the last decision; nearly sorted for the next. */
  private readonly byWorth: number[];
  /** Shares, urgencies and order for the ratios of the last decision. */
  private last:
    | {
        readonly ratios: Float64Array;
        readonly shares: Float64Array;
        readonly urgency: Float64Array;
        readonly order: readonly number[];
      }
    | undefined;

  constructor(
    private readonly units: readonly Unit[],
    private readonly splats: ArrayLike<number>,
    private readonly contribution: ArrayLike<number>,
  ) {
    this.links = new UnitLinks(units);
    this.byWorth = [...this.links.rows];
  }

  /**
   * Return the estimated gain per byte of each unit at the poses of the ratios: its gain times its row's ratio, squared
   * if it is below 1, over its bytes.
   */
  urgency(ratios: Float64Array): Float64Array {
    return Float64Array.from(this.units, ({ row, gain, size }) => {
      const ratio = row >= 0 ? ratios[row]! : 1;
      return ratio * Math.min(ratio, 1) * (gain / size);
    });
  }

  decide(ratios: Float64Array, holdings: Holdings): Decision {
    const { shares, urgency, order } = this.ordered(ratios);
    const round = new Round(this.units, this.splats, this.links, shares, urgency, order, this.byWorth, holdings);
    round.makeRoom(0);
    round.stopLessUrgent();
    while (!round.isFull) {
      const best = round.best();
      if (best === undefined) break;
      round.request(best);
    }
    return { stop: round.stopped, evict: round.evicted, fetch: round.chosen };
  }

  /** Return the shares of rows, and the urgency and the order of units, cached for the ratios of the last call. */
  private ordered(ratios: Float64Array): NonNullable<typeof this.last> {
    if (this.last?.ratios === ratios) return this.last;
    const shares = ratios.map((ratio, row) => ratio * this.contribution[row]!);
    const urgency = this.urgency(ratios);
    const order = this.units.map((_, unit) => unit).sort((a, b) => urgency[b]! - urgency[a]! || a - b);
    this.last = { ratios, shares, urgency, order };
    return this.last;
  }
}

/** A missing unit after its missing dependencies, with its estimated gain per byte. */
interface Chain {
  readonly units: readonly number[];
  readonly worth: number;
}

/** A decision in progress; its time follows the number of units, and not how many of them have arrived. */
class Round {
  readonly stopped: number[] = [];
  readonly evicted = new Map<number, number>();
  readonly chosen: number[] = [];
  /** By unit: 1 if it has arrived or is in flight. */
  private readonly held: Uint8Array;
  private readonly inFlight: Set<number>;
  private readonly received: Map<number, number>;
  private readonly skipped = new Set<number>();
  private readonly window: number;
  /** Bytes missing of the units in flight. */
  private bytesInFlight = 0;
  /** By row: 1 for the chunks to hold; undefined without a budget. */
  private readonly target: Uint8Array | undefined;
  /** Other chunks held, in the order of their eviction. */
  private readonly evictable: number[] = [];
  /** By row: worth of the chunk. */
  private readonly worths: Float64Array;
  /** Splats of the chunks held. */
  private heldSplats = 0;
  /** Missing units of chunks to hold and of no chunk, the most urgent first; some are requested since. */
  private candidates: readonly number[];

  constructor(
    private readonly units: readonly Unit[],
    private readonly splats: ArrayLike<number>,
    private readonly links: UnitLinks,
    /** By row: its share of the picture, in the unit of contributions. */
    private readonly shares: Float64Array,
    private readonly urgency: Float64Array,
    private readonly order: readonly number[],
    byWorth: number[],
    private readonly holdings: Holdings,
  ) {
    this.held = new Uint8Array(units.length);
    for (const unit of holdings.arrived) this.held[unit] = 1;
    for (const unit of holdings.inFlight) this.held[unit] = 1;
    this.inFlight = new Set(holdings.inFlight);
    this.received = new Map(holdings.received);
    this.window = windowBytes(holdings.bytesPerSecond, holdings.latency);
    for (const unit of this.inFlight) this.bytesInFlight += this.missingBytes(unit);
    this.worths = new Float64Array(links.headOf.length);
    if (holdings.budgetSplats > 0) this.target = this.chooseTarget(holdings.budgetSplats, byWorth);
    this.candidates = this.wanted();
  }

  /** Return the chunks to hold within the budget; list the held chunks to evict (docs/streaming.md, 9). */
  private chooseTarget(budget: number, byWorth: number[]): Uint8Array {
    const { worths, splats } = this;
    const { rows, parentOf, headOf } = this.links;
    const { evictedWorths } = this.holdings;
    for (const row of rows) {
      const head = headOf[row]!;
      if (this.held[head]) this.heldSplats += splats[row]!;
      worths[row] = (this.shares[row]! / Math.max(splats[row]!, 1)) * (this.held[head] ? HELD_FACTOR : 1);
    }
    for (let i = rows.length - 1; i >= 0; i--) {
      const parent = parentOf[rows[i]!]!;
      if (parent >= 0) worths[parent] = Math.max(worths[parent]!, worths[rows[i]!]!);
    }
    byWorth.sort((a, b) => worths[b]! - worths[a]! || a - b);
    const target = new Uint8Array(worths.length);
    let room = budget;
    for (const row of byWorth) {
      const parent = parentOf[row]!;
      if ((parent >= 0 && !target[parent]) || splats[row]! > room) continue;
      if (!this.held[headOf[row]!] && worths[row]! < (evictedWorths.get(row) ?? 0)) continue;
      target[row] = 1;
      room -= splats[row]!;
    }
    for (const row of byWorth) if (!target[row] && this.held[headOf[row]!]) this.evictable.push(row);
    this.evictable.reverse();
    return target;
  }

  /** Return the missing units of chunks to hold and of no chunk, the most urgent first. */
  private wanted(): number[] {
    const { target } = this;
    return this.order.filter((unit) => {
      if (this.held[unit]) return false;
      const { row } = this.units[unit]!;
      return row < 0 || target === undefined || target[row] === 1;
    });
  }

  /** Whether the bytes in flight fill the window. */
  get isFull(): boolean {
    return this.bytesInFlight >= this.window && this.inFlight.size > 0;
  }

  /** Return the most urgent chain, without units skipped in this decision. */
  best(): Chain | undefined {
    let best: Chain | undefined;
    for (const unit of this.candidates) {
      if (this.held[unit] || this.skipped.has(unit)) continue;
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
  stopLessUrgent(): void {
    const best = this.best();
    if (best === undefined) return;
    const { bytesPerSecond, latency } = this.holdings;
    const worths = this.worthsInFlight();
    for (const unit of [...this.inFlight].sort((a, b) => worths.get(a)! - worths.get(b)! || b - a)) {
      if (worths.get(unit)! * ABORT_FACTOR >= best.worth) break;
      // A unit that would arrive before another answer could begin is kept.
      if (this.missingBytes(unit) / bytesPerSecond <= latency || this.hasDependents(unit)) continue;
      this.stop(unit);
    }
    if (this.stopped.length > 0) this.candidates = this.wanted();
  }

  /** Return for each unit in flight the largest urgency of itself and of the missing units that depend on it. */
  private worthsInFlight(): Map<number, number> {
    const known = new Map<number, number>();
    const ofDependents = (unit: number): number => {
      let most = known.get(unit);
      if (most !== undefined) return most;
      most = 0;
      for (const other of this.links.dependents[unit]!) {
        most = Math.max(most, this.held[other] ? 0 : this.urgency[other]!, ofDependents(other));
      }
      known.set(unit, most);
      return most;
    };
    return new Map([...this.inFlight].map((unit) => [unit, Math.max(this.urgency[unit]!, ofDependents(unit))]));
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
    this.held[first] = 1;
    this.inFlight.add(first);
    this.bytesInFlight += this.missingBytes(first);
    this.chosen.push(first);
  }

  /** Stop a unit in flight. */
  private stop(unit: number): void {
    const { row, isHead } = this.units[unit]!;
    this.held[unit] = 0;
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
      const row = this.evictable.shift()!;
      // A head in flight may have been stopped.
      if (this.held[this.links.headOf[row]!]) this.evict(row);
    }
  }

  private evict(row: number): void {
    this.evicted.set(row, this.worths[row]!);
    for (const unit of this.links.unitsOf[row]!) {
      if (this.inFlight.has(unit)) this.stop(unit);
      else if (this.held[unit] && this.units[unit]!.isHead) this.heldSplats -= this.splats[row]!;
      this.held[unit] = 0;
      this.received.delete(unit);
    }
  }

  private missingBytes(unit: number): number {
    return this.units[unit]!.size - (this.received.get(unit) ?? 0);
  }

  /** Return the missing dependencies of a unit, then the unit. */
  private withDependencies(unit: number): number[] {
    const out: number[] = [];
    for (const before of this.units[unit]!.dependencies) {
      if (!this.held[before]) out.push(...this.withDependencies(before).filter((other) => !out.includes(other)));
    }
    return [...out, unit];
  }

  /** Return whether a unit that has arrived or is in flight depends on this one. */
  private hasDependents(unit: number): boolean {
    return this.links.dependents[unit]!.some((other) => this.held[other] === 1);
  }
}
