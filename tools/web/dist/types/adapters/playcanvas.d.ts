/**
 * Scenes in the PlayCanvas engine: the entry point `cogsplat/playcanvas`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { type AdapterOptions, type AdapterStream } from "./texel_stream.js";
export type { AdapterOptions, AdapterStream } from "./texel_stream.js";
/** What the adapter uses of a texture. */
export interface PlayCanvasTexture {
    lock(): {
        set(values: ArrayLike<number>): void;
    };
    unlock(): void;
}
/** What the adapter uses of the engine's `GSplatContainer`. */
export interface PlayCanvasContainer {
    readonly centers: Float32Array;
    readonly gsplatData: {
        shBands?: number;
    };
    readonly aabb: {
        readonly center: Settable;
        readonly halfExtents: Settable;
    };
    getTexture(name: string): PlayCanvasTexture | null;
    update(splats: number, centersUpdated?: boolean): void;
    configureMaterialDefines(defines: Map<string, string>): void;
    destroy(): void;
}
interface Settable {
    set(x: number, y: number, z: number): unknown;
}
/** What the adapter uses of the module `playcanvas`. */
export interface PlayCanvasModule<D, C extends PlayCanvasContainer> {
    readonly GSplatFormat: new (device: D, streams: {
        name: string;
        format: number;
    }[], options: {
        readGLSL: string;
        readWGSL: string;
    }) => unknown;
    readonly GSplatContainer: new (device: D, maxSplats: number, format: never) => C;
    readonly PIXELFORMAT_RGBA16F: number;
    readonly PIXELFORMAT_RGBA32U: number;
    readonly PIXELFORMAT_R32U: number;
}
/** A scene in PlayCanvas. */
export interface PlayCanvasScene<C extends PlayCanvasContainer> extends AdapterStream {
    /** The resource of a component: `entity.addComponent("gsplat", { resource })`. */
    readonly resource: C;
    /** Rotation x y z w of the entity, from the scene's axes to the engine's. */
    readonly rotation: readonly [number, number, number, number];
    /** Position of the entity. */
    readonly position: readonly [number, number, number];
}
/**
 * Stream a scene into a resource of PlayCanvas, all SH bands included.
 *
 * @param pc - The module `playcanvas`, 2.23 or a later 2.
 * @param device - The graphics device of the application.
 *
 * @example
 * ```ts
 * import * as pc from "playcanvas";
 * import { StreamedScene } from "cogsplat";
 * import { streamToPlayCanvas } from "cogsplat/playcanvas";
 *
 * const { resource, rotation, position, done } = streamToPlayCanvas(await StreamedScene.open(url), pc, app.graphicsDevice);
 * const entity = new pc.Entity();
 * entity.addComponent("gsplat", { resource });
 * entity.setLocalRotation(...rotation);
 * entity.setLocalPosition(...position);
 * app.root.addChild(entity);
 * await done;
 * ```
 */
export declare function streamToPlayCanvas<D, C extends PlayCanvasContainer>(scene: StreamedScene, pc: PlayCanvasModule<D, C>, device: D, options?: AdapterOptions): PlayCanvasScene<C>;
