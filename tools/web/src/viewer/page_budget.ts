import { budgetOf, thisDevice } from "./device_budget.js";

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
  private all: number;

  /** @param chosen - Splats in memory at most; by default those of the device. */
  constructor(private chosen?: number) {
    this.all = chosen ?? budgetOf(thisDevice(""));
  }

  /** Splats in memory at most, of all viewers together. */
  get total(): number {
    return this.all;
  }

  set total(splats: number) {
    this.all = this.chosen = splats;
    this.divide();
  }

  /** Adapt the budget to the graphics of the device, unless the page has chosen it. */
  adapt(graphics: string): void {
    const all = this.chosen ?? budgetOf(thisDevice(graphics));
    if (all === this.all) return;
    this.all = all;
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
