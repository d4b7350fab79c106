/** Memory of a device whose browser states none, GiB. Browsers state 8 at most. */
const USUAL_GIB = 8;
/** GiB from which touch screens have their whole budget. */
const GIB_OF_TOUCH = 4;
/** Shorter side of a screen, CSS pixels, from which a device with touch is a tablet. */
const TABLET_PX = 600;
/** Splats for each GiB of system memory, where the GPU has memory of its own; a splat takes about 180 bytes at SH degree 3. */
const SPLATS_PER_GIB = 1_500_000;
/** Splats in slower graphics, as in Spark 2 (sparkjs.dev). */
const BUDGETS = { headset: 500_000, phone: 1_000_000, tablet: 1_500_000, shared: 2_500_000 } as const;
const HEADSETS = /OculusBrowser|Quest|PicoBrowser/;
/** Graphics that share the computer's memory: of laptops, of small computers, and software. */
const SHARED_MEMORY = /Intel|Apple|Radeon(?!.*\b(?:RX|Pro)\b)|Adreno|Mali|SwiftShader|llvmpipe|Basic Render/;

/** Properties of a device by which its budget is chosen. */
export interface Device {
  readonly userAgent: string;
  /** Memory, GiB; undefined where the browser does not state it. Browsers state 8 at most. */
  readonly memoryGib: number | undefined;
  /** Whether the main pointer is a finger. */
  readonly isTouch: boolean;
  /** Shorter side of the screen, CSS pixels. */
  readonly screenPx: number;
  /** Name of the graphics in WebGL; empty before it is known. */
  readonly graphics: string;
}

/** Return the default number of splats in memory, of all viewers of a page. */
export function budgetOf({ userAgent, memoryGib = USUAL_GIB, isTouch, screenPx, graphics }: Device): number {
  if (HEADSETS.test(userAgent)) return BUDGETS.headset;
  if (isTouch) return BUDGETS[screenPx < TABLET_PX ? "phone" : "tablet"] * Math.min(memoryGib / GIB_OF_TOUCH, 1);
  const byMemory = memoryGib * SPLATS_PER_GIB;
  return SHARED_MEMORY.test(graphics) ? Math.min(byMemory, BUDGETS.shared) : byMemory;
}

/** Return this device. A server that renders pages has no navigator. */
export function thisDevice(graphics: string): Device {
  const { navigator, screen } = globalThis as {
    readonly navigator?: { readonly deviceMemory?: number; readonly userAgent?: string };
    readonly screen?: Screen;
  };
  return {
    userAgent: navigator?.userAgent ?? "",
    memoryGib: navigator?.deviceMemory,
    isTouch: globalThis.matchMedia?.("(pointer: coarse)").matches ?? false,
    screenPx: Math.min(screen?.width ?? Infinity, screen?.height ?? Infinity),
    graphics,
  };
}

/** Return the name of the graphics that draw in a context. */
export function graphicsOf(gl: WebGL2RenderingContext): string {
  // Chromium names itself unless it is asked by the extension, which Firefox warns of.
  const name = String(gl.getParameter(gl.RENDERER));
  const info = name.startsWith("WebKit") ? gl.getExtension("WEBGL_debug_renderer_info") : null;
  return info === null ? name : String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL));
}
