import type { OrbitCamera } from "./orbit.js";
/** How the pointer and the keys move the camera: around the scene, or through it. */
export type Movement = "orbit" | "fly";
/** Moves a camera by pointer, touch, wheel and keys. */
export declare class Controls {
    private readonly surface;
    private readonly camera;
    private readonly moved;
    movement: Movement;
    private readonly pointers;
    private readonly held;
    /**
     * @param surface - What is dragged on, and has the keyboard's focus.
     * @param camera - The camera of the scene that is shown, where one is.
     * @param moved - Called when the camera was moved, or is to be moved by `step`.
     * @param signal - Ends it.
     */
    constructor(surface: HTMLElement, camera: () => OrbitCamera | undefined, moved: () => void, signal: AbortSignal);
    /** Whether a key or a pointer is held. */
    get active(): boolean;
    /**
     * Move by the keys that are held.
     *
     * @param seconds - Since the last picture.
     * @returns Whether there are any.
     */
    step(seconds: number): boolean;
    private drag;
    private turn;
    private zoom;
}
