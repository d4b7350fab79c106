/** Return the opacity of a logit: the logistic function. */
export function opacityOf(logit: number): number {
  return 1 / (1 + Math.exp(-logit));
}

/** Return an opacity after a shift of its logit. */
export function shiftedOpacity(opacity: number, shift: number): number {
  const odds = opacity * Math.exp(shift);
  return odds / (odds + 1 - opacity);
}
