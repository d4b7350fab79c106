import type { OrbitCamera } from "./orbit.js";

/** Movement by pointer and keys: around the target, or through the scene. */
export type Movement = "orbit" | "fly";

/** Turning by keys, pointer pixels per second. */
const KEY_PIXELS = 300;
/** Flying by keys, distances to the target per second. */
const KEY_DISTANCES = 0.7;
/** Zooming by keys, factor per second. */
const KEY_ZOOM = 0.4;

/** Effects of held keys: turn right, turn down; fly right, down, forward; zoom in. */
const HELD: Readonly<Record<string, readonly [number, number, number, number, number, number]>> = {
  ArrowLeft: [-1, 0, 0, 0, 0, 0],
  ArrowRight: [1, 0, 0, 0, 0, 0],
  ArrowUp: [0, -1, 0, 0, 0, 0],
  ArrowDown: [0, 1, 0, 0, 0, 0],
  KeyA: [0, 0, -1, 0, 0, 0],
  KeyD: [0, 0, 1, 0, 0, 0],
  KeyQ: [0, 0, 0, 1, 0, 0],
  KeyE: [0, 0, 0, -1, 0, 0],
  KeyW: [0, 0, 0, 0, 1, 0],
  KeyS: [0, 0, 0, 0, -1, 0],
  Equal: [0, 0, 0, 0, 0, 1],
  NumpadAdd: [0, 0, 0, 0, 0, 1],
  Minus: [0, 0, 0, 0, 0, -1],
  NumpadSubtract: [0, 0, 0, 0, 0, -1],
};

/** Longest way of a finger and longest time of a tap, px and ms; longest time between the taps of a double tap, ms. */
const TAP_PIXELS = 8;
const TAP_MILLISECONDS = 300;
const DOUBLE_TAP_MILLISECONDS = 350;

interface Pointer {
  readonly x: number;
  readonly y: number;
}

/** A press that may become a tap. */
interface Press extends Pointer {
  readonly id: number;
  readonly time: number;
}

/** Functions of a viewer that its controls call. */
export interface ControlsHost {
  /** Return the camera of the scene shown, if any. */
  camera(): OrbitCamera | undefined;
  /** Called when a pointer, the wheel or a key begins to act, before the camera moves. */
  touched(): void;
  /** Called when the camera has moved, or `step` will move it. */
  moved(): void;
  /** Return whether the wheel and one finger belong to the page. */
  leavesScrolling(): boolean;
  /** Called when the page got a wheel or a finger that the viewer would take otherwise. */
  left(input: "wheel" | "finger"): void;
  /** Called after a tap or click, and after a double one; px from the corner of the surface. */
  tapped(x: number, y: number, isDouble: boolean): void;
}

/** Moves a camera by pointer, touch, wheel and keys. */
export class Controls {
  movement: Movement = "orbit";
  private readonly pointers = new Map<number, Pointer>();
  private readonly held = new Set<string>();
  private press: Press | undefined;
  private lastTap: Press | undefined;
  /** Whether the mouse was pressed since the surface got the focus: from then on the wheel is the viewer's. */
  private hasWheel = false;

  /**
   * @param surface - Element that receives pointer and keyboard events.
   * @param signal - Removes the listeners.
   */
  constructor(
    private readonly surface: HTMLElement,
    private readonly host: ControlsHost,
    signal: AbortSignal,
  ) {
    const on = <K extends keyof HTMLElementEventMap>(name: K, act: (event: HTMLElementEventMap[K]) => void): void =>
      surface.addEventListener(name, act, { signal, passive: false });
    on("contextmenu", (event) => event.preventDefault());
    on("pointerdown", (event) => {
      surface.setPointerCapture(event.pointerId);
      const pointer = { x: event.clientX, y: event.clientY };
      this.pointers.set(event.pointerId, pointer);
      this.press = this.pointers.size === 1 ? { ...pointer, id: event.pointerId, time: performance.now() } : undefined;
      this.hasWheel ||= event.pointerType !== "touch";
      host.touched();
    });
    // A browser scrolls by two fingers too, unless their touches are refused.
    on("touchstart", (event) => {
      if (event.touches.length > 1) event.preventDefault();
    });
    on("pointermove", (event) => this.drag(event));
    on("pointerup", (event) => this.tap(event));
    on("pointercancel", (event) => {
      this.press = undefined;
      if (event.pointerType === "touch" && host.leavesScrolling()) host.left("finger");
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      on(name, (event) => this.pointers.delete(event.pointerId));
    }
    on("wheel", (event) => {
      if (host.leavesScrolling() && !this.hasWheel && !event.ctrlKey && !event.metaKey) {
        host.left("wheel");
        return;
      }
      event.preventDefault();
      host.touched();
      // A line is about 16 px; a touchpad's pinch is a wheel event with the control key and smaller steps.
      const isPinch = event.ctrlKey && Math.abs(event.deltaY) < 50;
      const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1) * (isPinch ? 10 : 1);
      this.zoom(Math.exp(pixels / 1000));
    });
    on("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || HELD[event.code] === undefined) return;
      event.preventDefault();
      this.held.add(event.code);
      host.touched();
      host.moved();
    });
    on("keyup", (event) => this.held.delete(event.code));
    on("blur", () => {
      this.held.clear();
      this.hasWheel = false;
    });
  }

  /** Whether a key or a pointer is held. */
  get active(): boolean {
    return this.held.size > 0 || this.pointers.size > 0;
  }

  /**
   * Move the camera by the held keys.
   *
   * @param seconds - Time since the last picture.
   * @returns Whether any key is held.
   */
  step(seconds: number): boolean {
    const camera = this.host.camera();
    if (this.held.size === 0 || camera === undefined) return false;
    const [turnX, turnY, right, down, forward, nearer] = [0, 1, 2, 3, 4, 5].map((i) =>
      [...this.held].reduce((sum, key) => sum + HELD[key]![i]!, 0),
    ) as [number, number, number, number, number, number];
    this.turn(camera, -turnX * seconds * KEY_PIXELS, -turnY * seconds * KEY_PIXELS);
    const distance = seconds * KEY_DISTANCES;
    camera.fly(right * distance, down * distance, forward * distance);
    camera.zoom(KEY_ZOOM ** (nearer * seconds));
    return true;
  }

  private drag(event: PointerEvent): void {
    const before = this.pointers.get(event.pointerId);
    const camera = this.host.camera();
    if (before === undefined || camera === undefined) return;
    const now = { x: event.clientX, y: event.clientY };
    this.pointers.set(event.pointerId, now);
    const { press } = this;
    if (press !== undefined && Math.hypot(now.x - press.x, now.y - press.y) > TAP_PIXELS) this.press = undefined;
    const leaves = event.pointerType === "touch" && this.host.leavesScrolling();
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    const height = this.surface.clientHeight;
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other !== undefined) {
      // Each of two fingers moves their centre by half of its own movement.
      if (leaves) this.turn(camera, dx / 2, dy / 2);
      else camera.move(dx / 2, dy / 2, height);
      const [from, to] = [before, now].map((p) => Math.hypot(p.x - other.x, p.y - other.y)) as [number, number];
      if (from > 0 && to > 0) this.zoom(from / to);
    } else if (leaves) {
      // The page does not scroll this way, so that the browser left the finger to the viewer.
      if (this.press === undefined) this.host.left("finger");
      return;
    } else if (event.shiftKey || (event.buttons & 6) !== 0) camera.move(dx, dy, height);
    else this.turn(camera, dx, dy);
    this.host.moved();
  }

  /** Report a tap, if this pointer's release ends one. */
  private tap({ pointerId, button }: PointerEvent): void {
    const { press, lastTap } = this;
    const now = performance.now();
    if (press?.id !== pointerId || button !== 0 || now - press.time > TAP_MILLISECONDS) return;
    const isDouble =
      lastTap !== undefined &&
      now - lastTap.time < DOUBLE_TAP_MILLISECONDS &&
      Math.hypot(press.x - lastTap.x, press.y - lastTap.y) < 3 * TAP_PIXELS;
    this.lastTap = isDouble ? undefined : { ...press, time: now };
    const { left, top } = this.surface.getBoundingClientRect();
    this.host.tapped(press.x - left, press.y - top, isDouble);
  }

  private turn(camera: OrbitCamera, dx: number, dy: number): void {
    if (dx === 0 && dy === 0) return;
    if (this.movement === "orbit") camera.turn(dx, dy);
    else camera.turnInPlace(dx, dy);
  }

  private zoom(factor: number): void {
    const camera = this.host.camera();
    if (this.movement === "orbit") camera?.zoom(factor);
    else camera?.fly(0, 0, 1 - factor);
    this.host.moved();
  }
}
