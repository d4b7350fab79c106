import type { Kernels } from "../kernels/kernels.js";
import { readIndexParams, readIndices } from "../streams/codebook_index.js";
import { Attribute, Kind, type Payload, type StreamRecord } from "../streams/records.js";
import {
  BASIS_STRIDE,
  checkBasisEntries,
  readShnCodebook,
  readShnCoordinates,
  readShnParams,
  type ShnCoordinates,
} from "../streams/shn_basis.js";
import { BAND_FLOATS, bandAttributes, type Codebooks, type ColourCodebook, readBand } from "./codebooks.js";

/** SH coefficients above DC of a chunk, in the form of its tail. */
export type TailSource =
  | {
      readonly form: "bands" /** For each band the address of its rows, where it is there. */;
      readonly bands: readonly (number | undefined)[];
    }
  | {
      readonly form: "indices";
      readonly indices: number;
      readonly codebook: ColourCodebook;
      readonly escapes: readonly (number | undefined)[];
    }
  | { readonly form: "basis"; readonly coordinates: ShnCoordinates /** Rows of 48 f32. */; readonly basis: number };

/**
 * Read a tail up to a degree (SPEC 7.3).
 *
 * @param needs - Codebooks that the tail's segment needs, as a bit set.
 * @param shDegree - SH degree of the scene.
 * @param degree - SH degree to read; higher bands are skipped.
 */
export function readTail(
  k: Kernels,
  tail: Payload,
  needs: number,
  codebooks: Codebooks,
  shDegree: number,
  degree: number,
): TailSource {
  const source = tail.has(Attribute.shN)
    ? readOnCodebook(k, tail, needs, codebooks, shDegree, degree)
    : { form: "bands" as const, bands: readBands(k, tail, shDegree, degree) };
  tail.finish();
  return source;
}

function readOnCodebook(
  k: Kernels,
  tail: Payload,
  needs: number,
  codebooks: Codebooks,
  shDegree: number,
  degree: number,
): TailSource {
  const stream = tail.take(Attribute.shN);
  if (stream.kind === Kind.basis) return readBasis(k, stream, needs, codebooks, degree);
  const { codebook: number, escapes } = readIndexParams(stream);
  const escaped = escapes > 0 ? readBands(k, tail, shDegree, degree, escapes) : [];
  const codebook = codebooks.colour(number, needs, degree);
  const indices = readIndices(k, stream, codebook.rows, escapes);
  return { form: "indices", indices, codebook, escapes: escaped };
}

/**
 * Return the addresses of the bands present, up to the degree to read; higher bands are skipped.
 *
 * @param escapes - Number of escape rows; undefined for the rows of the chunk.
 */
function readBands(
  k: Kernels,
  tail: Payload,
  shDegree: number,
  degree: number,
  escapes?: number,
): (number | undefined)[] {
  const addresses = bandAttributes(shDegree).map((attribute, band) => {
    if (!tail.has(attribute, escapes !== undefined)) return undefined;
    const stream = escapes === undefined ? tail.take(attribute) : tail.takeEscape(attribute, escapes);
    if (band >= degree) return undefined;
    const target = k.alloc(4 * stream.rows * BAND_FLOATS[band]!);
    readBand(k, stream, target);
    return target;
  });
  return addresses.slice(0, degree);
}

function readBasis(k: Kernels, stream: StreamRecord, needs: number, codebooks: Codebooks, degree: number): TailSource {
  const book = codebooks.colour(readShnCodebook(stream), needs, degree);
  const { width, ...params } = readShnParams(stream, book.rows);
  const basis = k.alloc(4 * BASIS_STRIDE * width);
  const rows = k.f32.subarray(basis >>> 2, (basis >>> 2) + BASIS_STRIDE * width).fill(0);
  let first = 0;
  for (let band = 0; band < degree; band++) {
    const floats = BAND_FLOATS[band]!;
    const from = k.f32.subarray(book.bands[band]! >>> 2);
    for (let j = 0; j < width; j++) {
      rows.set(from.subarray(floats * j, floats * (j + 1)), BASIS_STRIDE * j + first);
    }
    first += floats;
  }
  checkBasisEntries(rows);
  return { form: "basis", coordinates: readShnCoordinates(k, stream, { width, ...params }), basis };
}

/**
 * Write the coefficients of every row, row by row.
 *
 * @param target - Address of `rows` rows of 3·((degree + 1)² − 1) f32.
 */
export function writeShn(k: Kernels, source: TailSource, rows: number, degree: number, target: number): void {
  const floats = shnFloats(degree);
  if (source.form === "basis") {
    const { order, counts, width, columns } = source.coordinates;
    k.shnSum(order, counts, width, columns, source.basis, floats, target);
    return;
  }
  let first = 0;
  for (let band = 0; band < degree; band++) {
    const width = BAND_FLOATS[band]!;
    const to = target + 4 * first;
    first += width;
    if (source.form === "bands") {
      copyBand(k, source.bands[band], rows, width, to, floats);
    } else {
      const escapes = source.escapes[band] ?? zeros(k, width * rows);
      k.gather(source.codebook.bands[band]!, escapes, source.codebook.rows, source.indices, rows, width, to, floats);
    }
  }
}

function copyBand(k: Kernels, band: number | undefined, rows: number, width: number, to: number, floats: number): void {
  const from = band ?? zeros(k, width * rows);
  const { f32 } = k;
  for (let row = 0; row < rows; row++) {
    const at = (from >>> 2) + row * width;
    f32.copyWithin((to >>> 2) + row * floats, at, at + width);
  }
}

function zeros(k: Kernels, floats: number): number {
  const address = k.alloc(4 * floats);
  k.u8.fill(0, address, address + 4 * floats);
  return address;
}

/** Return the number of values of a row's coefficients above DC. */
export function shnFloats(degree: number): number {
  return 3 * ((degree + 1) ** 2 - 1);
}
