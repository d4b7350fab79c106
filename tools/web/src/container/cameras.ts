import { CogsplatError } from "../errors.js";
import { Fields, textBytes } from "./fields.js";
import { parseMap } from "./msgpack.js";
import { isRotation, type Pinhole } from "./pinhole.js";
import { float64Column } from "./tables.js";

/** A camera of the views that the scene was trained or encoded with. */
export interface Camera extends Pinhole {
  readonly name: string;
}

const MAX_CAMERAS = 65_536;
/** Values of a map of cameras at most (SPEC 4.1). */
const MAX_VALUES = 131_072;

/** Read a segment of cameras (SPEC 5.8). */
export function readCameras(payload: Uint8Array): Camera[] {
  const fields = new Fields(parseMap(payload, MAX_VALUES), "cameras");
  const names = fields.array("name");
  const width = fields.column("width", 2);
  const count = width.byteLength / 2;
  const height = fields.column("height", 2, count);
  const [fx, fy, cx, cy] = (["fx", "fy", "cx", "cy"] as const).map((key) =>
    float64Column(fields.column(key, 8, count)),
  );
  const rotation = float64Column(fields.column("rotation", 72, count));
  const translation = float64Column(fields.column("translation", 24, count));
  const texts = names.filter((name) => typeof name === "string");
  if (names.length !== count || texts.length !== count) {
    throw new CogsplatError("root-columns", `${texts.length} names of ${count} cameras`);
  }
  fields.finish();
  if (count < 1 || count > MAX_CAMERAS) throw fields.outOfRange("width", `${count} cameras`);
  if (texts.some((name) => textBytes(name) > 255)) throw fields.outOfRange("name", "more than 255 bytes");
  return texts.map((name, i) => {
    const camera: Camera = {
      name,
      width: width.getUint16(2 * i, true),
      height: height.getUint16(2 * i, true),
      fx: fx![i]!,
      fy: fy![i]!,
      cx: cx![i]!,
      cy: cy![i]!,
      rotation: Array.from(rotation.subarray(9 * i, 9 * i + 9)),
      translation: Array.from(translation.subarray(3 * i, 3 * i + 3)),
    };
    const numbers = [camera.fx, camera.fy, camera.cx, camera.cy, ...camera.rotation, ...camera.translation];
    if (camera.width < 1 || camera.height < 1) throw fields.outOfRange("width", `camera ${i} has no pixels`);
    if (!numbers.every(Number.isFinite)) throw fields.outOfRange("fx", `a number of camera ${i} is not finite`);
    if (!(camera.fx > 0 && camera.fy > 0)) throw fields.outOfRange("fx", `camera ${i} has no focal length above 0`);
    if (!isRotation(camera.rotation)) throw fields.outOfRange("rotation", `camera ${i} has no rotation matrix`);
    return camera;
  });
}
