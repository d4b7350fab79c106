/** Splats in memory for each GiB that a computer has, about 130 bytes each with their textures. */
const SPLATS_PER_GIB = 1_500_000;
/** GiB of a device that does not state its memory; none states more. */
const USUAL_GIB = 8;
/** GiB of the phones that the budget of phones is for. */
const GIB_OF_PHONES = 4;
/** Budgets of devices with slower graphics, as in Spark 2 (sparkjs.dev): headsets, phones, touch screens. */
const BUDGET_OF_HEADSETS = 500_000;
const BUDGET_OF_PHONES = 1_000_000;
const BUDGET_OF_TOUCH_SCREENS = 1_500_000;

/** Request of a viewer. */
export interface Wish {
  /** Splats of the scene, or the page's limit for the viewer; Infinity before the scene is open. */
  readonly splats: number;
  /** Area of the viewer, 0 out of sight. */
  readonly size: number;
  /** Whether the page has chosen the number of splats; other viewers do not reduce it. */
  readonly isChosen: boolean;
}

/** A viewer of the page, and the function that sets its share. */
interface Member {
  wish: Wish;
  share: number | undefined;
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
   * @param apply - Called with a new share.
   */
  ask(viewer: object, wish: Wish, apply: (share: number) => void): void {
    const known = this.members.get(viewer);
    if (known !== undefined && JSON.stringify(known.wish) === JSON.stringify(wish)) return;
    this.members.set(viewer, { wish, share: known?.share, apply });
    this.divide();
  }

  /** Give back the share of a viewer. */
  leave(viewer: object): void {
    if (this.members.delete(viewer)) this.divide();
  }

  /** Divide the budget by size among viewers in sight; viewers out of sight share the rest. */
  private divide(): void {
    const members = [...this.members.values()];
    let left = this.all;
    const shares: [Member, number][] = [];
    const give = (group: Member[], size: (member: Member) => number): void => {
      const need = (member: Member): number => member.wish.splats / size(member);
      let sizes = group.reduce((sum, member) => sum + size(member), 0);
      // Splats that small scenes leave go to large scenes.
      for (const member of group.sort((a, b) => (need(a) < need(b) ? -1 : 1))) {
        const share = Math.floor((left * size(member)) / sizes);
        sizes -= size(member);
        left -= Math.min(member.wish.splats, share);
        // A scene that needs less than its share may still grow to it.
        shares.push([member, share]);
      }
    };
    for (const member of members.filter(({ wish }) => wish.isChosen)) {
      left = Math.max(left - member.wish.splats, 0);
      shares.push([member, Infinity]);
    }
    const others = members.filter(({ wish }) => !wish.isChosen);
    give(
      others.filter(({ wish }) => wish.size > 0),
      ({ wish }) => wish.size,
    );
    give(
      others.filter(({ wish }) => wish.size === 0),
      () => 1,
    );
    for (const [member, share] of shares) {
      if (member.share === share) continue;
      member.share = share;
      member.apply(share);
    }
  }
}

/** Return the budget for this device. */
function budgetOfDevice(): number {
  // A server that renders pages has no navigator.
  const device = globalThis.navigator as { readonly deviceMemory?: number; readonly userAgent?: string } | undefined;
  const gib = device?.deviceMemory ?? USUAL_GIB;
  const agent = device?.userAgent ?? "";
  if (/OculusBrowser|Quest|PicoBrowser/.test(agent)) return BUDGET_OF_HEADSETS;
  const ofPhone = /Android/.test(agent) ? BUDGET_OF_PHONES : BUDGET_OF_TOUCH_SCREENS;
  return globalThis.matchMedia?.("(pointer: coarse)").matches
    ? ofPhone * Math.min(gib / GIB_OF_PHONES, 1)
    : gib * SPLATS_PER_GIB;
}
