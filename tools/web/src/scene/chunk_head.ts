import type { Kernels } from "../kernels/kernels.js";
import { readIndexParams, readIndices } from "../streams/codebook_index.js";
import { readFloatStream } from "../streams/float_streams.js";
import { readGridStream } from "../streams/grid_streams.js";
import { readQuats, readSwingTwist } from "../streams/quat_streams.js";
import { Attribute, checkKind, checkRows, Kind, type Payload, type StreamRecord } from "../streams/records.js";
import { readSortedMeans } from "../streams/sorted_means.js";
import { readPlainColumns, readShapeRows, type Codebooks } from "./codebooks.js";

/** A head's rows: addresses of columns of f32. */
export interface HeadColumns {
  readonly means: readonly number[];
  /** Natural logarithms. */
  readonly scales: readonly number[];
  /** w x y z, unit length, w ≥ 0. */
  readonly quats: readonly number[];
  /** Logits. */
  readonly opacities: number;
  readonly sh0: readonly number[];
}

const PLAIN = [Attribute.scales, Attribute.quats, Attribute.means, Attribute.opacities, Attribute.sh0];
const WITH_SHAPE = [Attribute.shape, Attribute.scaleFactor, Attribute.means, Attribute.opacities, Attribute.sh0];

/**
 * Decode a head, refined where its refinement is there (SPEC 7.2, 7.4).
 *
 * @param head - The head's streams.
 * @param refinement - The refinement's, where it is there.
 * @param rows - Splats of the chunk.
 * @param needs - Codebooks that the head's segment needs.
 */
export function readHead(
  k: Kernels, head: Payload, refinement: Payload | undefined, rows: number, needs: number, codebooks: Codebooks,
): HeadColumns {
  const shape = head.find(Attribute.shape);
  refinement?.only(refinable(shape !== undefined));
  const { coarse, scales, quats } =
    shape === undefined
      ? readPlainShape(k, head, refinement, rows)
      : readIndexedShape(k, head, shape, rows, needs, codebooks);
  const means = head.get(Attribute.means);
  const opacities = head.get(Attribute.opacities);
  const sh0 = head.get(Attribute.sh0);
  for (const stream of [means, opacities, sh0]) checkRows(stream, rows);
  const refined = (attribute: number) => refinementOf(refinement, attribute, rows);
  return {
    means: readMeans(k, means, coarse, refined(Attribute.means)),
    scales,
    quats,
    opacities: readValues(k, opacities, refined(Attribute.opacities))[0]!,
    sh0: readValues(k, sh0, refined(Attribute.sh0)),
  };
}

interface Shape {
  /** Scales as the head alone gives them; step models depend on these. */
  readonly coarse: readonly number[];
  readonly scales: readonly number[];
  readonly quats: readonly number[];
}

function readPlainShape(k: Kernels, head: Payload, refinement: Payload | undefined, rows: number): Shape {
  for (const attribute of PLAIN) head.get(attribute);
  head.only(PLAIN);
  const stream = head.get(Attribute.scales);
  const quatStream = head.get(Attribute.quats);
  checkRows(stream, rows);
  checkRows(quatStream, rows);
  const coarse = readValues(k, stream, undefined);
  const digits = refinementOf(refinement, Attribute.scales, rows);
  const scales = digits === undefined ? coarse : readValues(k, stream, digits);
  const quats = quatStream.kind === Kind.swingTwist ? readSwingTwist(k, quatStream, coarse) : readQuats(k, quatStream);
  return { coarse, scales, quats };
}

function readIndexedShape(
  k: Kernels, head: Payload, shape: StreamRecord, rows: number, needs: number, codebooks: Codebooks,
): Shape {
  for (const attribute of WITH_SHAPE) head.get(attribute);
  checkRows(shape, rows);
  const { codebook, escapes } = readIndexParams(shape);
  const escapeAttributes = escapes > 0 ? [Attribute.scales, Attribute.quats] : [];
  for (const attribute of escapeAttributes) head.get(attribute, true);
  head.only(WITH_SHAPE, escapeAttributes);
  const book = codebooks.shape(codebook, needs);
  const escaped = escapes > 0 ? readShapeRows(k, head, escapes, true) : [];
  const indices = readIndices(k, shape, book.rows, escapes);
  const columns = [...book.scales, ...book.quats].map((column, i) => {
    const target = k.alloc(4 * rows);
    k.gather(column, escaped[i] ?? 0, book.rows, indices, rows, 1, target, 1);
    return target;
  });
  const factor = head.get(Attribute.scaleFactor);
  checkRows(factor, rows);
  const [factors] = readPlainColumns(k, factor);
  const scales = columns.slice(0, 3);
  for (const column of scales) k.add(column, factors!, rows);
  return { coarse: scales, scales, quats: columns.slice(3) };
}

/** Attributes that a refinement may have (SPEC 7.4). */
function refinable(indexed: boolean): number[] {
  const attributes: number[] = [Attribute.means, Attribute.opacities, Attribute.sh0];
  return indexed ? attributes : [Attribute.scales, ...attributes];
}

function refinementOf(refinement: Payload | undefined, attribute: number, rows: number): StreamRecord | undefined {
  const stream = refinement?.find(attribute);
  if (stream !== undefined) checkRows(stream, rows);
  return stream;
}

function readMeans(
  k: Kernels, stream: StreamRecord, scales: readonly number[], refinement: StreamRecord | undefined,
): readonly number[] {
  if (stream.kind === Kind.sorted) return readSortedMeans(k, stream, scales, refinement);
  return readValues(k, stream, refinement);
}

function readValues(k: Kernels, stream: StreamRecord, refinement: StreamRecord | undefined): readonly number[] {
  if (refinement !== undefined) {
    // Digits refine codes on grids; bits refine sorted means alone (SPEC 6.16, 6.17).
    checkKind(refinement, [Kind.digits]);
    if (stream.kind === Kind.float) checkKind(stream, [Kind.scalar, Kind.differences, Kind.basis]);
  }
  return stream.kind === Kind.float ? readFloatStream(k, stream) : readGridStream(k, stream, refinement);
}
