/** Return the opacity of a logit: the logistic function. */
export function opacityOf(logit: number): number {
  return 1 / (1 + Math.exp(-logit));
}
