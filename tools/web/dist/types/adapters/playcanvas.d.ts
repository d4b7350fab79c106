import type { Splats } from "../scene/splats.js";
/** A property of the element that `pc.GSplatData` takes. */
export interface GSplatProperty {
    readonly type: "float";
    readonly name: string;
    readonly storage: Float32Array;
    readonly byteSize: 4;
}
/** The element `vertex` that `pc.GSplatData` takes. */
export interface GSplatElement {
    readonly name: "vertex";
    readonly count: number;
    readonly properties: GSplatProperty[];
}
/**
 * Splats as the PlayCanvas engine takes them, all SH bands included.
 *
 * Its world is `RUB`: give the entity the rotation of `axesRotation(scene.axes)`.
 *
 * @example
 * ```ts
 * const data = new pc.GSplatData([toGSplatElement(splats)]);
 * entity.addComponent("gsplat").instance = new pc.GSplatInstance(new pc.GSplatResource(device, data));
 * ```
 */
export declare function toGSplatElement(splats: Splats): GSplatElement;
