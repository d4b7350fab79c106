import type { Viewpoint } from "../container/root.js";
import type { PlyScene } from "./ply_messages.js";

/** Length of a header at most, bytes; one of 3DGS at SH degree 3 has about 1,500. */
export const MOST_HEADER_BYTES = 65_536;

const SIZES: Readonly<Record<string, number>> = {
  char: 1,
  uchar: 1,
  int8: 1,
  uint8: 1,
  short: 2,
  ushort: 2,
  int16: 2,
  uint16: 2,
  int: 4,
  uint: 4,
  int32: 4,
  uint32: 4,
  float: 4,
  float32: 4,
  double: 8,
  float64: 8,
};
const COMMENT = /^comment cogsplat (\w+) (.*)$/;

/** Layout of a splat's values in a PLY of 3DGS training. */
export interface PlyLayout {
  readonly scene: PlyScene;
  /** Length of the header and of a row, bytes. */
  readonly headerBytes: number;
  readonly stride: number;
  /** Byte offset in a row of means, scales, quats, opacity, sh0, then bands coefficient by coefficient. */
  readonly columns: readonly number[];
}

/**
 * Read the header of a PLY.
 *
 * @param bytes - First bytes of the file.
 * @returns undefined where the header does not end in `bytes`.
 * @throws Error with a sentence for a person where the file is no PLY of splats, or of an unsupported kind.
 */
export function readPlyHeader(bytes: Uint8Array): PlyLayout | undefined {
  const text = new TextDecoder("latin1").decode(bytes.subarray(0, MOST_HEADER_BYTES));
  if (!/^ply\r?\n/.test(text.slice(0, 5)) && bytes.length >= 5)
    throw new Error("This file is neither a .cogs file nor a PLY.");
  const end = /end_header\r?\n/.exec(text);
  if (end === null) {
    if (bytes.length >= MOST_HEADER_BYTES) throw new Error("The header of this PLY has no end.");
    return undefined;
  }
  const headerBytes = end.index + end[0].length;
  const lines = text.slice(0, end.index).split(/\r?\n/);
  if (!lines.includes("format binary_little_endian 1.0")) {
    throw new Error("This PLY is not binary little-endian, the kind that splat trainers write.");
  }
  const elements = lines.filter((line) => line.startsWith("element "));
  const count = /^element vertex (\d+)$/.exec(elements[0] ?? "");
  if (count === null || elements.length > 1)
    throw new Error("This PLY has other elements than splats; convert it first.");
  const offsets = new Map<string, number>();
  let stride = 0;
  for (const line of lines) {
    const property = /^property (\w+) (\w+)$/.exec(line);
    if (property === null) continue;
    const size = SIZES[property[1]!];
    if (size === undefined) throw new Error(`This PLY has a property of the type ${property[1]}, which is not read.`);
    if (property[1] === "float" || property[1] === "float32") offsets.set(property[2]!, stride);
    stride += size;
  }
  const at = (name: string) => {
    const offset = offsets.get(name);
    if (offset === undefined) throw new Error(`This PLY has no splats: it lacks the property ${name}.`);
    return offset;
  };
  const rest = [...offsets.keys()].filter((name) => name.startsWith("f_rest_")).length / 3;
  const shDegree = [0, 3, 8, 15].indexOf(rest);
  if (shDegree < 0)
    throw new Error(`This PLY has ${3 * rest} SH coefficients above DC, which no degree from 0 to 3 has.`);
  const names = [
    "x",
    "y",
    "z",
    "scale_0",
    "scale_1",
    "scale_2",
    "rot_0",
    "rot_1",
    "rot_2",
    "rot_3",
    "opacity",
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
  ];
  // The PLY stores coefficients channel by channel.
  const shN = Array.from({ length: 3 * rest }, (_, i) => `f_rest_${(i % 3) * rest + Math.floor(i / 3)}`);
  const said = new Map(lines.map((line) => COMMENT.exec(line)).flatMap((m) => (m ? [[m[1]!, m[2]!] as const] : [])));
  const origin = (said.get("origin") ?? "0 0 0").split(" ").map(Number);
  return {
    scene: {
      splats: Number(count[1]),
      shDegree,
      origin,
      axes: said.get("axes") ?? "RDF",
      linear: said.get("colour_space") === "linear",
      kernelPx: Number(said.get("kernel_px") ?? 0.3),
      antialiased: said.get("antialiased") === "true" || lines.includes("comment SplatRenderMode: mip"),
      capture: lines.flatMap((line) => {
        const comment = COMMENT.exec(line);
        return comment?.[1] === "capture" ? readViewpoint(comment[2]!) : [];
      }),
    },
    headerBytes,
    stride,
    columns: [...names, ...shN].map(at),
  };
}

/** Return the viewpoint that a comment states, relative to the file's zero; none where it is not one. */
function readViewpoint(text: string): Viewpoint[] {
  const [x, y, z, focalPx, ...more] = text.split(" ").map(Number) as [number, number, number, number];
  const known = more.length === 0 && [x, y, z, focalPx].every(Number.isFinite) && focalPx > 0;
  return known ? [{ position: [x, y, z], focalPx }] : [];
}
