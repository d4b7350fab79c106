/**
 * Scenes in the PlayCanvas engine: the entry point `cogsplat/playcanvas`.
 *
 * @packageDocumentation
 */
import type { StreamedScene } from "../loader/streamed_scene.js";
import { type PlayCanvasApplication } from "./playcanvas_sorting.js";
import { type AdapterOptions, type AdapterStream } from "./texel_stream.js";
export type { PlayCanvasApplication } from "./playcanvas_sorting.js";
export type { AdapterOptions, AdapterStream } from "./texel_stream.js";
/** How a scene is streamed into PlayCanvas. */
export interface PlayCanvasOptions extends AdapterOptions {
    /**
     * Rows that the engine is given at least; those beyond the scene's show nothing. In WebGL the engine sorts few splats by few
     * keys, a quarter of their number and 1,025 at least, so that many share one: with 65,536 rows it sorts by 16,385. None by default.
     */
    readonly leastRows?: number;
    /**
     * The application that shows the scene. Where it is given, the splats are sorted once more when its cameras have come to
     * rest: PlayCanvas 2.23.3 forgets a view that comes while it sorts for another one.
     */
    readonly application?: PlayCanvasApplication;
}
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
/** Parts of shaders, by their names. */
export interface PlayCanvasChunks {
    get(name: string): string | undefined;
    set(name: string, text: string): unknown;
}
/** What `drawBySpec` uses of the module `playcanvas`. */
export interface PlayCanvasShaders {
    readonly ShaderChunks: {
        get(device: never, language: "glsl"): PlayCanvasChunks;
    };
}
/** What `drawBySpec` sets of an application. */
export interface PlayCanvasSettings {
    readonly graphicsDevice: unknown;
    readonly scene: {
        readonly gsplat: {
            minPixelSize: number;
            antiAlias: boolean;
            readonly material: {
                getShaderChunks(language: "glsl"): PlayCanvasChunks;
            };
        };
    };
}
/**
 * Have PlayCanvas draw more nearly by the rules of SPEC 8.7, in WebGL: Gaussians to where they add 1/255, the scene's
 * kernel, and the Jacobian of a point within 1.3 times the picture. In WebGL the engine (2.23.3, its
 * `gsplat-unified-sort-worker`) sorts by whole-numbered keys: 2^b + 1 of them, where b is log₂ of a quarter of the number of
 * splats, rounded and held between 10 and 20, so 1,025 up to 5,792 splats. Splats of one key are drawn in an order that has
 * nothing to do with their depths. No setting changes the number of keys; `leastRows` of `streamToPlayCanvas` does, by rows
 * that show nothing.
 *
 * Call it before the first picture. It holds for all splats of the application.
 *
 * @returns Whether the engine's shaders are known; those of another version are left as they are.
 *
 * @example
 * ```ts
 * app.start();
 * drawBySpec(pc, app, scene);
 * ```
 */
export declare function drawBySpec(pc: PlayCanvasShaders, app: PlayCanvasSettings, { info }: Pick<StreamedScene, "info">): boolean;
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
export declare function streamToPlayCanvas<D, C extends PlayCanvasContainer>(scene: StreamedScene, pc: PlayCanvasModule<D, C>, device: D, options?: PlayCanvasOptions): PlayCanvasScene<C>;
