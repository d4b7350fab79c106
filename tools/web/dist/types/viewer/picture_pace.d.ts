/** A picture: pixels of each side, as a share of all, and its splats. */
interface Picture {
    readonly scale: number;
    readonly splats: number;
}
/**
 * Follows the pictures that the graphics work on, so that no more are begun than they can finish: those that wait would
 * show what is no longer asked for, and full queues hold up the page.
 */
export declare class PicturePace {
    private readonly gl;
    /** Duration of the last picture, from its first command until the graphics had finished it, ms. */
    milliseconds: number;
    /** Pixels of each side that pictures in haste have, as a share of all; few until it is known how long a picture takes. */
    scale: number;
    /** Splats of the next picture, as far as they have come. */
    splats: number;
    /** Splats of the last picture. */
    private drawn;
    private readonly underWay;
    constructor(gl: WebGL2RenderingContext);
    /** How long the next picture takes by what the last one took, ms. */
    get expected(): number;
    /** Whether the graphics take so long that work between pictures matters. */
    get isSlow(): boolean;
    /** Whether nothing is left to finish. */
    get isIdle(): boolean;
    /** Whether another picture may be begun: quick graphics work on one while the next is prepared. */
    get isFree(): boolean;
    /**
     * Note that the commands of a picture were given.
     *
     * @param begun - When the first of them was, by `performance.now`.
     */
    given(begun: number, picture: Picture): void;
    /** Note that textures are uploaded, which is no picture but takes its time too. */
    uploads(): void;
    private follow;
    /** Forget pictures of graphics that were lost. */
    forget(): void;
    private look;
}
export {};
