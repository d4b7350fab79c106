/** The opacity of a logit: the logistic function. */
export function opacityOf(logit: number): number {
  return 1 / (1 + Math.exp(-logit));
}

/** The opacity whose logit is larger by a shift. */
export function shiftedOpacity(opacity: number, shift: number): number {
  const odds = opacity * Math.exp(shift);
  return odds / (odds + 1 - opacity);
}
