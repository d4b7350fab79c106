import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { readIndexParams, readIndices } from "../streams/codebook_index.js";
import { Attribute, checkRows, Kind, type Payload, type StreamRecord } from "../streams/records.js";
import {
  BASIS_STRIDE, checkBasisEntries, readShnCoordinates, readShnParams, type ShnCoordinates,
} from "../streams/shn_basis.js";
import { BAND_FLOATS, bandAttributes, readBand, type Codebooks, type ColourCodebook } from "./codebooks.js";

/** SH coefficients above DC of a chunk, in the form in which its tail has them. */
export type TailSource =
  | { readonly form: "bands"; /** For each band the address of its rows, where it is there. */ readonly bands: readonly (number | undefined)[] }
  | {
      readonly form: "indices";
      readonly indices: number;
      readonly codebook: ColourCodebook;
      readonly escapes: readonly (number | undefined)[];
    }
  | { readonly form: "basis"; readonly coordinates: ShnCoordinates; /** Rows of 48 f32. */ readonly basis: number };

/**
 * Read a tail up to a degree (SPEC 7.3).
 *
 * @param rows - Splats of the chunk.
 * @param needs - Codebooks that the tail's segment needs.
 * @param shDegree - Degree of the scene.
 * @param degree - Degree wanted; bands above it are not read.
 */
export function readTail(
  k: Kernels, tail: Payload, rows: number, needs: number, codebooks: Codebooks, shDegree: number, degree: number,
): TailSource {
  const stream = tail.find(Attribute.shN);
  if (stream === undefined) {
    tail.only(bandAttributes(shDegree));
    return { form: "bands", bands: readBands(k, tail, rows, degree, false) };
  }
  checkRows(stream, rows);
  if (stream.kind === Kind.basis) {
    tail.only([Attribute.shN]);
    return readBasis(k, stream, needs, codebooks, degree);
  }
  const { codebook: number, escapes } = readIndexParams(stream);
  tail.only([Attribute.shN], escapes > 0 ? bandAttributes(shDegree) : []);
  const codebook = codebooks.colour(number, needs, degree);
  const escaped = readBands(k, tail, escapes, degree, true);
  const indices = readIndices(k, stream, codebook.rows, escapes);
  return { form: "indices", indices, codebook, escapes: escaped };
}

function readBands(k: Kernels, tail: Payload, rows: number, degree: number, escape: boolean): (number | undefined)[] {
  return bandAttributes(degree).map((attribute, band) => {
    const stream = tail.find(attribute, escape);
    if (stream === undefined) return undefined;
    const target = k.alloc(4 * rows * BAND_FLOATS[band]!);
    readBand(k, stream, rows, target);
    return target;
  });
}

function readBasis(
  k: Kernels, stream: StreamRecord, needs: number, codebooks: Codebooks, degree: number,
): TailSource {
  const params = readShnParams(stream);
  const book = codebooks.colour(params.codebook, needs, degree);
  if (params.width > book.rows) {
    throw new CogsplatError("basis-width", `${params.width} coordinates on a basis of ${book.rows} rows`);
  }
  const basis = k.alloc(4 * BASIS_STRIDE * params.width);
  const rows = k.f32.subarray(basis >>> 2, (basis >>> 2) + BASIS_STRIDE * params.width).fill(0);
  let first = 0;
  for (let band = 0; band < degree; band++) {
    const floats = BAND_FLOATS[band]!;
    const from = k.f32.subarray(book.bands[band]! >>> 2);
    for (let j = 0; j < params.width; j++) {
      rows.set(from.subarray(floats * j, floats * (j + 1)), BASIS_STRIDE * j + first);
    }
    first += floats;
  }
  checkBasisEntries(rows);
  return { form: "basis", coordinates: readShnCoordinates(k, stream, params), basis };
}

/**
 * The coefficients of every row, one after the other.
 *
 * @param target - Address of `rows` rows of 3·((degree + 1)² − 1) f32.
 */
export function writeShn(k: Kernels, source: TailSource, rows: number, degree: number, target: number): void {
  const floats = shnFloats(degree);
  if (source.form === "basis") {
    const { order, counts, width, columns } = source.coordinates;
    k.shnSum(order, counts, rows, width, columns, source.basis, floats, target);
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

/** Values of a row's coefficients above DC. */
export function shnFloats(degree: number): number {
  return 3 * ((degree + 1) ** 2 - 1);
}
