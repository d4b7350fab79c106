/** The opacity of a logit: the logistic function. */
export declare function opacityOf(logit: number): number;
/** The opacity whose logit is larger by a shift. */
export declare function shiftedOpacity(opacity: number, shift: number): number;
