/** The line between two scenes, to be dragged or moved by arrow keys. */
export declare class Divide {
    private readonly line;
    private readonly moved;
    /** Where it is, as a share of the width. */
    private share;
    constructor(line: HTMLElement, moved: (share: number) => void, signal: AbortSignal);
    /** Show it at a share of the width, or take it away. */
    set shown(shown: boolean);
    private place;
}
