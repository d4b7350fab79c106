/** Return an address relative to a page as an absolute one; a malformed address stays as it is. */
export function absoluteAddress(address: string, base: string | undefined): string {
  try {
    return new URL(address, base).href;
  } catch {
    return address;
  }
}

/** Return the path of an address; a malformed address is its own path. */
export function pathOf(address: string): string {
  try {
    return new URL(address, globalThis.location?.href).pathname;
  } catch {
    return address;
  }
}

/** Return the file name of an address, for people. */
export function sceneName(address: string): string {
  const name = pathOf(address).split("/").at(-1)!;
  try {
    return decodeURIComponent(name);
  } catch {
    // A percent sign that begins no escape is part of the name.
    return name;
  }
}

/** Return the file name of a source; empty for bytes without a name. */
export function fileName(source: unknown): string {
  if (source instanceof File) return source.name;
  if (typeof source !== "string") return "";
  return sceneName(source);
}
