import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { readPlane } from "./planes.js";
import { Attribute, checkParams, checkPlanes, type StreamRecord } from "./records.js";

/** Read the columns of a float stream (SPEC 6.8). */
export function readFloatStream(k: Kernels, stream: StreamRecord): number[] {
  const columns = Array.from({ length: stream.components }, () => k.alloc(4 * stream.rows));
  readFloats(k, stream, columns, 1);
  return columns;
}

/**
 * Read a float stream row by row, as SH bands are stored.
 *
 * @param target - Address of `rows` rows of one f32 per component.
 */
export function readFloatRows(k: Kernels, stream: StreamRecord, target: number): void {
  const { components } = stream;
  readFloats(
    k,
    stream,
    Array.from({ length: components }, (_, i) => target + 4 * i),
    components,
  );
}

function readFloats(k: Kernels, stream: StreamRecord, targets: readonly number[], stride: number): void {
  checkParams(stream, 0);
  checkPlanes(stream, 4 * stream.components);
  const planes = k.alloc(16);
  targets.forEach((target, component) => {
    for (let byte = 0; byte < 4; byte++) {
      const address = readPlane(k, stream.planes[4 * component + byte]!, stream.rows);
      k.u32[(planes >>> 2) + byte] = address;
    }
    if (k.floats(planes, stream.rows, stream.attribute === Attribute.opacities, target, stride) !== 0) {
      throw new CogsplatError("float-value", `${stream.name}: NaN, or too large a magnitude`);
    }
  });
}
