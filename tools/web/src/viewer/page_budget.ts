/** Splats in memory for each GiB that the device has, about 130 bytes each with their textures. */
const SPLATS_PER_GIB = 1_500_000;
/** GiB of a device that does not state its memory; none states more. */
const USUAL_GIB = 8;
/** Splats on touch screens at most: phones have less memory and power. */
const BUDGET_OF_PHONES = 1_500_000;

/** A viewer of the page: the splats that its scene has, and the function that sets its share. */
interface Member {
  wish: number;
  share: number;
  readonly apply: (share: number) => void;
}

/** Divides one budget of splats among the viewers of a page. */
export class PageBudget {
  private readonly members = new Map<object, Member>();

  constructor(private all = budgetOfDevice()) {}

  /** Splats in memory at most, of all viewers together. */
  get total(): number {
    return this.all;
  }

  set total(splats: number) {
    this.all = splats;
    this.divide();
  }

  /**
   * Ask for splats; the share may change whenever another viewer asks.
   *
   * @param splats - Splats of the scene; Infinity before they are known.
   * @param apply - Called with a new share.
   */
  ask(viewer: object, splats: number, apply: (share: number) => void): void {
    const known = this.members.get(viewer);
    if (known?.wish === splats) return;
    this.members.set(viewer, { wish: splats, share: known?.share ?? -1, apply });
    this.divide();
  }

  /** Give back the share of a viewer. */
  leave(viewer: object): void {
    if (this.members.delete(viewer)) this.divide();
  }

  /** Give everybody an even share; what small scenes leave goes to large ones. */
  private divide(): void {
    let left = this.all;
    const waiting = [...this.members.values()].sort((a, b) => a.wish - b.wish);
    waiting.forEach((member, i) => {
      const even = Math.floor(left / (waiting.length - i));
      left -= Math.min(member.wish, even);
      // A scene that needs less than its share may still grow to it.
      if (member.share === even) return;
      member.share = even;
      member.apply(even);
    });
  }
}

/** Return the budget for the memory of this device. */
function budgetOfDevice(): number {
  // A server that renders pages has no navigator.
  const device = globalThis.navigator as { readonly deviceMemory?: number } | undefined;
  const budget = (device?.deviceMemory ?? USUAL_GIB) * SPLATS_PER_GIB;
  return globalThis.matchMedia?.("(pointer: coarse)").matches ? Math.min(budget / 4, BUDGET_OF_PHONES) : budget;
}
