/** What `sortBehindCameras` uses of an application of PlayCanvas. */
export interface PlayCanvasApplication {
    readonly scene: PlayCanvasEvents;
    readonly systems: {
        readonly camera?: {
            readonly cameras: readonly {
                readonly entity: PlayCanvasNode;
            }[];
        };
    };
    on(name: "frameend", told: () => void): PlayCanvasHandle;
}
interface PlayCanvasEvents {
    on(name: "gsplat:sorted", told: () => void): PlayCanvasHandle;
}
interface PlayCanvasHandle {
    off(): unknown;
}
interface PlayCanvasNode {
    readonly forward: {
        readonly x: number;
        readonly y: number;
        readonly z: number;
    };
}
/**
 * Ask for another sort when the cameras have come to rest.
 *
 * PlayCanvas 2.23.3 sorts in a worker, one order after the other. A view that comes while it sorts is noted as sorted
 * (`GSplatManager.update`), though `GSplatUnifiedSorter.setSortParams` has thrown the request away: the splats then keep
 * the order of an earlier view until a camera turns again.
 *
 * @param again - Makes the engine sort by the cameras as they are now.
 * @returns What ends it.
 */
export declare function sortBehindCameras(app: PlayCanvasApplication, again: () => void): () => void;
export {};
