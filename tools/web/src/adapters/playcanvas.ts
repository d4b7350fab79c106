import type { Splats } from "../scene/splats.js";
import { plyProperties } from "./ply.js";

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
export function toGSplatElement(splats: Splats): GSplatElement {
  const coefficients = (splats.shDegree + 1) ** 2 - 1;
  const column = (from: Float32Array, width: number, component: number) =>
    Float32Array.from({ length: splats.count }, (_, i) => from[width * i + component]!);
  const sources = new Map<string, () => Float32Array>();
  ["x", "y", "z"].forEach((name, axis) => sources.set(name, () => column(splats.means, 3, axis)));
  for (let i = 0; i < 3; i++) {
    sources.set(`f_dc_${i}`, () => column(splats.sh0, 3, i));
    sources.set(`scale_${i}`, () => column(splats.scales, 3, i));
  }
  for (let i = 0; i < 4; i++) sources.set(`rot_${i}`, () => column(splats.quats, 4, i));
  sources.set("opacity", () => splats.opacities);
  for (let i = 0; i < 3 * coefficients; i++) {
    const [channel, k] = [Math.floor(i / coefficients), i % coefficients];
    sources.set(`f_rest_${i}`, () => column(splats.shN, 3 * coefficients, 3 * k + channel));
  }
  const names = plyProperties(splats.shDegree).filter((name) => sources.has(name));
  return {
    name: "vertex",
    count: splats.count,
    properties: names.map((name) => ({ type: "float", name, storage: sources.get(name)!(), byteSize: 4 })),
  };
}
