/** Part of a PlayCanvas application that `sortBehindCameras` uses. */
export interface PlayCanvasApplication {
  readonly scene: PlayCanvasEvents;
  readonly systems: {
    readonly camera?: { readonly cameras: readonly { readonly entity: PlayCanvasNode }[] } | undefined;
  };
  on(name: "frameend", told: () => void): PlayCanvasHandle;
}

interface PlayCanvasEvents {
  on(name: "gsplat:sorted", told: () => void): PlayCanvasHandle;
}

/** Subscription to an event of PlayCanvas. */
export interface PlayCanvasHandle {
  off(): unknown;
}

interface PlayCanvasNode {
  readonly forward: { readonly x: number; readonly y: number; readonly z: number };
}

/**
 * Sort again when the cameras have come to rest.
 *
 * PlayCanvas 2.23.3 sorts in a worker, one order at a time. `GSplatManager.update` marks a view that arrives during a
 * sort as sorted, although `GSplatUnifiedSorter.setSortParams` has dropped it. The splats then keep the order of an
 * earlier view until a camera turns again.
 *
 * @param again - Makes the engine sort for the present cameras.
 * @returns Function that ends it.
 */
export function sortBehindCameras(app: PlayCanvasApplication, again: () => void): () => void {
  let [seen, moved, answered] = ["", false, false];
  const sorted = app.scene.on("gsplat:sorted", () => (answered = true));
  const drawn = app.on("frameend", () => {
    const cameras = app.systems.camera?.cameras ?? [];
    const now = cameras.map(({ entity: { forward } }) => `${forward.x} ${forward.y} ${forward.z}`).join();
    if (now !== seen) {
      [seen, moved, answered] = [now, true, false];
    } else if (moved && answered) {
      // An order has arrived since the last movement: the worker is idle and accepts the next request.
      moved = false;
      again();
    }
  });
  return () => {
    sorted.off();
    drawn.off();
  };
}
