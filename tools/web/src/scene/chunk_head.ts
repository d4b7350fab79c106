import type { Kernels } from "../kernels/kernels.js";
import { readIndexParams, readIndices } from "../streams/codebook_index.js";
import { readFloatStream } from "../streams/float_streams.js";
import { readGridStream } from "../streams/grid_streams.js";
import { readQuats, readSwingTwist } from "../streams/quat_streams.js";
import { Attribute, Kind, type Payload, type StreamRecord } from "../streams/records.js";
import { readSortedMeans } from "../streams/sorted_means.js";
import { type Codebooks, readPlainColumns, readShapeRows } from "./codebooks.js";

/** Addresses of the columns of a decoded head, f32 each. */
export interface HeadColumns {
  readonly means: readonly number[];
  /** Natural logarithms of scales. */
  readonly scales: readonly number[];
  /** Quaternions w x y z of unit length, w ≥ 0. */
  readonly quats: readonly number[];
  /** Logits. */
  readonly opacities: number;
  readonly sh0: readonly number[];
}

/**
 * Decode a head and, if present, its refinement (SPEC 7.2, 7.4).
 *
 * @param head - Streams of the head.
 * @param refinement - Streams of the refinement, if present.
 * @param rows - Splats of the chunk.
 * @param needs - Codebooks that the head's segment needs, as a bit set.
 */
export function readHead(
  k: Kernels,
  head: Payload,
  refinement: Payload | undefined,
  rows: number,
  needs: number,
  codebooks: Codebooks,
): HeadColumns {
  const { coarse, scales, quats } = head.has(Attribute.shape)
    ? readIndexedShape(k, head, rows, needs, codebooks)
    : readPlainShape(k, head, refinement);
  const means = readRefined(k, head, refinement, Attribute.means, coarse);
  const opacities = readRefined(k, head, refinement, Attribute.opacities, coarse)[0]!;
  const sh0 = readRefined(k, head, refinement, Attribute.sh0, coarse);
  head.finish();
  refinement?.finish();
  return { means, scales, quats, opacities, sh0 };
}

/**
 * Decode the opacities of a later level (SPEC 7.5).
 *
 * @param payload - Streams of the segment.
 * @param before - Address of the opacities of head and refinement, to which differences are added.
 * @param rows - Splats of the chunk.
 * @returns Address of the level's opacities.
 */
export function readOpacities(k: Kernels, payload: Payload, before: number, rows: number): number {
  const stream = payload.take(Attribute.opacities);
  const values = readValues(k, stream, undefined)[0]!;
  payload.finish();
  if (stream.kind !== Kind.differences) return values;
  k.add(before, values, rows);
  return before;
}

interface Shape {
  /** Scales of the head without refinement, on which step models depend. */
  readonly coarse: readonly number[];
  readonly scales: readonly number[];
  readonly quats: readonly number[];
}

function readPlainShape(k: Kernels, head: Payload, refinement: Payload | undefined): Shape {
  const stream = head.take(Attribute.scales);
  const digits = refinement?.takeRefining(stream);
  const coarse = readValues(k, stream, undefined);
  const scales = digits === undefined ? coarse : readValues(k, stream, digits);
  const quatStream = head.take(Attribute.quats);
  const quats = quatStream.kind === Kind.swingTwist ? readSwingTwist(k, quatStream, coarse) : readQuats(k, quatStream);
  return { coarse, scales, quats };
}

function readIndexedShape(k: Kernels, head: Payload, rows: number, needs: number, codebooks: Codebooks): Shape {
  const shape = head.take(Attribute.shape);
  const { codebook, escapes } = readIndexParams(shape);
  const escaped = escapes > 0 ? readShapeRows(k, head, escapes) : [];
  const book = codebooks.shape(codebook, needs);
  const indices = readIndices(k, shape, book.rows, escapes);
  const columns = [...book.scales, ...book.quats].map((column, i) => {
    const target = k.alloc(4 * rows);
    k.gather(column, escaped[i] ?? 0, book.rows, indices, rows, 1, target, 1);
    return target;
  });
  const [factors] = readPlainColumns(k, head.take(Attribute.scaleFactor));
  const scales = columns.slice(0, 3);
  for (const column of scales) k.add(column, factors!, rows);
  return { coarse: scales, scales, quats: columns.slice(3) };
}

/** Read an attribute and its refinement. */
function readRefined(
  k: Kernels,
  head: Payload,
  refinement: Payload | undefined,
  attribute: number,
  coarse: readonly number[],
): readonly number[] {
  const stream = head.take(attribute);
  const refining = refinement?.takeRefining(stream);
  return stream.kind === Kind.sorted ? readSortedMeans(k, stream, coarse, refining) : readValues(k, stream, refining);
}

function readValues(k: Kernels, stream: StreamRecord, refining: StreamRecord | undefined): readonly number[] {
  return stream.kind === Kind.float ? readFloatStream(k, stream) : readGridStream(k, stream, refining);
}
