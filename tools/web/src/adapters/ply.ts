import type { Splats } from "../scene/splats.js";

/** Options of `toPly`. */
export interface PlyOptions {
  /** Offset added to every mean, for example the scene's origin for world positions; zeros by default. */
  readonly origin?: readonly number[];
}

/** Return the property names of a splat in the PLY of 3DGS training, in file order. */
export function plyProperties(shDegree: number): string[] {
  const rest = 3 * ((shDegree + 1) ** 2 - 1);
  return [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
    ...Array.from({ length: rest }, (_, i) => `f_rest_${i}`),
    "opacity",
    "scale_0",
    "scale_1",
    "scale_2",
    "rot_0",
    "rot_1",
    "rot_2",
    "rot_3",
  ];
}

/**
 * Write splats as the binary PLY of 3DGS training.
 *
 * @example
 * ```ts
 * const file = new SceneFile(bytes, (await loadKernels())());
 * const ply = toPly(file.decode(), { origin: file.scene.origin });
 * ```
 */
export function toPly(splats: Splats, { origin = [0, 0, 0] }: PlyOptions = {}): Uint8Array {
  const names = plyProperties(splats.shDegree);
  const header = [
    "ply",
    "format binary_little_endian 1.0",
    `element vertex ${splats.count}`,
    ...names.map((name) => `property float ${name}`),
    "end_header",
    "",
  ].join("\n");
  const text = new TextEncoder().encode(header);
  const bytes = new Uint8Array(text.length + 4 * names.length * splats.count);
  bytes.set(text);
  const view = new DataView(bytes.buffer, text.length);
  const coefficients = (splats.shDegree + 1) ** 2 - 1;
  let at = 0;
  const put = (value: number) => {
    view.setFloat32(at, value, true);
    at += 4;
  };
  for (let i = 0; i < splats.count; i++) {
    for (let axis = 0; axis < 3; axis++) put(splats.means[3 * i + axis]! + origin[axis]!);
    for (let axis = 0; axis < 3; axis++) put(0);
    for (let channel = 0; channel < 3; channel++) put(splats.sh0[3 * i + channel]!);
    // The PLY stores coefficients channel by channel.
    for (let channel = 0; channel < 3; channel++) {
      for (let k = 0; k < coefficients; k++) put(splats.shN[3 * (coefficients * i + k) + channel]!);
    }
    put(splats.opacities[i]!);
    for (let axis = 0; axis < 3; axis++) put(splats.scales[3 * i + axis]!);
    for (let component = 0; component < 4; component++) put(splats.quats[4 * i + component]!);
  }
  return bytes;
}
