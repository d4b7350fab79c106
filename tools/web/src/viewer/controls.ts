import type { OrbitCamera } from "./orbit.js";

/** How the pointer and the keys move the camera: around the scene, or through it. */
export type Movement = "orbit" | "fly";

/** Turning by keys, px of the pointer a second. */
const KEY_PIXELS = 300;
/** Flying by keys, distances to the target a second. */
const KEY_DISTANCES = 0.7;
/** Coming nearer by keys: the factor of a second. */
const KEY_ZOOM = 0.4;

/** Keys that move while they are held, and what they do: turn right, turn down; fly right, down, forward; come nearer. */
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

interface Pointer {
  readonly x: number;
  readonly y: number;
}

/** Moves a camera by pointer, touch, wheel and keys. */
export class Controls {
  movement: Movement = "orbit";
  private readonly pointers = new Map<number, Pointer>();
  private readonly held = new Set<string>();

  /**
   * @param surface - What is dragged on, and has the keyboard's focus.
   * @param camera - The camera of the scene that is shown, where one is.
   * @param moved - Called when the camera was moved, or is to be moved by `step`.
   * @param signal - Ends it.
   */
  constructor(
    private readonly surface: HTMLElement,
    private readonly camera: () => OrbitCamera | undefined,
    private readonly moved: () => void,
    signal: AbortSignal,
  ) {
    const on = <K extends keyof HTMLElementEventMap>(name: K, act: (event: HTMLElementEventMap[K]) => void): void =>
      surface.addEventListener(name, act, { signal, passive: false });
    on("contextmenu", (event) => event.preventDefault());
    on("pointerdown", (event) => {
      surface.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    on("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      on(name, (event) => this.pointers.delete(event.pointerId));
    }
    on("wheel", (event) => {
      event.preventDefault();
      // A line is about 16 px; a pinch of a touchpad comes as a wheel with the control key, in smaller steps.
      const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1) * (event.ctrlKey ? 10 : 1);
      this.zoom(Math.exp(pixels / 1000));
    });
    on("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || HELD[event.code] === undefined) return;
      event.preventDefault();
      this.held.add(event.code);
      this.moved();
    });
    on("keyup", (event) => this.held.delete(event.code));
    on("blur", () => this.held.clear());
  }

  /** Whether a key or a pointer is held. */
  get active(): boolean {
    return this.held.size > 0 || this.pointers.size > 0;
  }

  /**
   * Move by the keys that are held.
   *
   * @param seconds - Since the last picture.
   * @returns Whether there are any.
   */
  step(seconds: number): boolean {
    const camera = this.camera();
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
    const camera = this.camera();
    if (before === undefined || camera === undefined) return;
    const now = { x: event.clientX, y: event.clientY };
    this.pointers.set(event.pointerId, now);
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    const height = this.surface.clientHeight;
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other !== undefined) {
      // Each of two fingers moves the middle by half of its way.
      camera.move(dx / 2, dy / 2, height);
      const [from, to] = [before, now].map((p) => Math.hypot(p.x - other.x, p.y - other.y)) as [number, number];
      if (from > 0 && to > 0) this.zoom(from / to);
    } else if (event.shiftKey || (event.buttons & 6) !== 0) camera.move(dx, dy, height);
    else this.turn(camera, dx, dy);
    this.moved();
  }

  private turn(camera: OrbitCamera, dx: number, dy: number): void {
    if (dx === 0 && dy === 0) return;
    if (this.movement === "orbit") camera.turn(dx, dy);
    else camera.look(dx, dy);
  }

  private zoom(factor: number): void {
    const camera = this.camera();
    if (this.movement === "orbit") camera?.zoom(factor);
    else camera?.fly(0, 0, 1 - factor);
    this.moved();
  }
}
