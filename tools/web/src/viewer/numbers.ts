/** Format bytes with three digits and a unit of 1000. */
export function formatBytes(bytes: number): string {
  const units = ["bytes", "kB", "MB", "GB"];
  let value = bytes;
  let unit = 0;
  while (value >= 999.5 && unit < units.length - 1) {
    value /= 1000;
    unit++;
  }
  return `${unit === 0 ? value : Number(value.toPrecision(3))} ${units[unit]!}`;
}

/** Format a part of some bytes, such as `120 of 305 kB`. */
export function formatShare(part: number, whole: number): string {
  const [texts, ofWhole] = [formatBytes(part), formatBytes(whole)];
  const unit = ofWhole.slice(ofWhole.indexOf(" "));
  return `${texts.endsWith(unit) ? texts.slice(0, -unit.length) : texts} of ${ofWhole}`;
}

/** Parse a CSS colour to R, G, B and opacity from 0 to 1; undefined for an invalid one. */
export function parseColour(text: string): [number, number, number, number] | undefined {
  if (!CSS.supports("color", text)) return undefined;
  const context = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true })!;
  context.fillStyle = text;
  context.fillRect(0, 0, 1, 1);
  return Array.from(context.getImageData(0, 0, 1, 1).data, (byte) => byte / 255) as [number, number, number, number];
}
