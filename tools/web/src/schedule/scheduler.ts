/**
 * Bytes in flight beyond one round trip, as seconds of the connection: requests never run dry, and few are made early.
 */
const AHEAD_SECONDS = 0.25;
/** Least ratio between the worth of an incoming chunk and of a chunk evicted for it. */
const EVICT_FACTOR = 2;
/** Least ratio between the urgency of the best missing unit and of a unit stopped for it. */
const ABORT_FACTOR = 16;

/** A segment that a client may fetch; units are in file order. */
export interface Unit {
  /** Chunk of the segment; −1 for segments of no chunk, for example of codebooks. */
  readonly chunk: number;
  readonly isHead: boolean;
  /** End of the segment in the file, bytes. */
  readonly end: number;
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
  /** Estimated throughput. */
  readonly bytesPerSecond: number;
  /** Time from a request to its first byte, seconds. */
  readonly latency: number;
}

/** Actions of a client, in this order. */
export interface Decision {
  /** Units in flight to stop; their received bytes are kept. */
  readonly stop: readonly number[];
  /** Chunks to evict. */
  readonly evict: readonly number[];
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
    units.forEach(({ chunk, isHead }, at) => {
      if (isHead) this.heads.set(chunk, at);
    });
  }

  /** Return the estimated gain per byte of each unit: its chunk's ratio over the square of its end in the file. */
  urgency(ratios: Float64Array): Float64Array {
    return Float64Array.from(this.units, ({ chunk, end }) => (chunk >= 0 ? ratios[chunk]! : 1) / (end * end));
  }

  decide(ratios: Float64Array, holdings: Holdings): Decision {
    const { urgency, order } = this.ordered(ratios);
    const round = new Round(this.units, this.splats, this.heads, urgency, holdings);
    round.stopLessUrgent(order);
    round.makeRoom(Infinity, []);
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
  readonly evicted: number[] = [];
  readonly chosen: number[] = [];
  private readonly arrived: Set<number>;
  private readonly inFlight: Set<number>;
  private readonly received: Map<number, number>;
  private readonly skipped = new Set<number>();
  private readonly window: number;
  /** Bytes missing of the units in flight. */
  private bytesInFlight = 0;
  /** Chunks whose heads are held; computed when a budget first applies. */
  private held: { readonly chunks: Set<number>; splats: number; leastWorth: number | undefined } | undefined;

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
  }

  /** Whether the bytes in flight fill the window. */
  get isFull(): boolean {
    return this.bytesInFlight >= this.window && this.inFlight.size > 0;
  }

  /** Return the most urgent chain, without units that found no room. */
  best(order: readonly number[]): Chain | undefined {
    let best: Chain | undefined;
    for (const unit of order) {
      if (this.isHeld(unit) || this.skipped.has(unit)) continue;
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
    const { inFlight, bytesPerSecond, latency } = this.holdings;
    const worths = this.worths();
    for (const unit of [...inFlight].sort((a, b) => worths.get(a)! - worths.get(b)! || b - a)) {
      if (worths.get(unit)! * ABORT_FACTOR >= best.worth) break;
      // A unit that would arrive before another answer could begin is kept.
      if (this.missingBytes(unit) / bytesPerSecond <= latency || this.hasDependents(unit)) continue;
      this.stop(unit);
    }
  }

  /** Return the worth of each unit in flight: the urgency of the most urgent missing unit that depends on it. */
  private worths(): Map<number, number> {
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

  /** Request the first unit of a chain, or skip the chain from now on if there is no room for it. */
  request({ units }: Chain): void {
    const first = units[0]!;
    const last = units[units.length - 1]!;
    const { chunk, isHead } = this.units[first]!;
    // A decision does not request again what it stops or evicts.
    const isGone = units.some((unit) => this.stopped.includes(unit) || this.evicted.includes(this.units[unit]!.chunk));
    if (isGone || (isHead && !this.makeRoom(this.holdingWorth(last), units))) {
      this.skipped.add(last);
      return;
    }
    if (isHead) this.hold(chunk);
    this.inFlight.add(first);
    this.bytesInFlight += this.missingBytes(first);
    this.chosen.push(first);
  }

  /** Stop a unit in flight. */
  private stop(unit: number): void {
    this.inFlight.delete(unit);
    this.bytesInFlight -= this.missingBytes(unit);
    this.stopped.push(unit);
  }

  /** Return the worth of holding a unit, without the cost of its position in the file. */
  private holdingWorth(unit: number): number {
    return this.urgency[unit]! * this.units[unit]!.end;
  }

  private missingBytes(unit: number): number {
    return this.units[unit]!.size - (this.received.get(unit) ?? 0);
  }

  private isHeld(unit: number): boolean {
    return this.arrived.has(unit) || this.inFlight.has(unit);
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

  /**
   * Evict chunks of less worth until the first head of a chain fits.
   *
   * @param keep - Worth of holding the chain.
   * @param chain - Units of which the first is a head; empty to enforce a lowered budget.
   * @returns false, without any eviction, unless all heads of the chain would fit: a parent without its children would
   *   be
   * evicted again for others, without end.
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
      const chunk = this.leastWorthy(held, kept, keep);
      if (chunk === undefined) return false;
      held.delete(chunk);
      used -= this.splats[chunk]!;
      going.push(chunk);
    }
    // Room for the other heads is made when they are requested.
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
      this.arrived.delete(unit);
      if (this.inFlight.has(unit)) this.stop(unit);
      this.received.delete(unit);
    });
  }

  private worth(chunk: number): number {
    return this.holdingWorth(this.heads.get(chunk)!);
  }

  /** Return the chunks of some units and of all their dependencies. */
  private ancestors(chain: readonly number[]): Set<number> {
    const found = new Set<number>();
    const left = [...chain];
    for (let unit = left.pop(); unit !== undefined; unit = left.pop()) {
      const { chunk, dependencies } = this.units[unit]!;
      if (chunk >= 0) found.add(chunk);
      left.push(...dependencies);
    }
    return found;
  }

  /** Return the chunk to evict first: the least worth, and parent of no chunk held. */
  private leastWorthy(held: ReadonlySet<number>, kept: ReadonlySet<number>, urgency: number): number | undefined {
    const parents = new Set(
      [...held].flatMap((chunk) =>
        this.units[this.heads.get(chunk)!]!.dependencies.map((unit) => this.units[unit]!.chunk),
      ),
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
