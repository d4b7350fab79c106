import type { CodebookEntry } from "../container/root.js";
import { SegmentKind } from "../container/tables.js";
import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { readFloatRows, readFloatStream } from "../streams/float_streams.js";
import { readGridStream, readScalarRows } from "../streams/grid_streams.js";
import { readQuats } from "../streams/quat_streams.js";
import { Attribute, Kind, Payload, type StreamRecord } from "../streams/records.js";

/** Values of a row in each SH band, coefficients times channels. */
export const BAND_FLOATS = [9, 15, 21] as const;
const BAND_ATTRIBUTES = [Attribute.sh1, Attribute.sh2, Attribute.sh3] as const;

/** Rows of a shape codebook: three columns of scales, four of quaternions. */
export interface ShapeCodebook {
  readonly rows: number;
  readonly scales: readonly number[];
  readonly quats: readonly number[];
}

/** Rows of a colour codebook: for each band there is, the address of its rows. */
export interface ColourCodebook {
  readonly rows: number;
  readonly bands: (number | undefined)[];
}

/** The codebooks of a scene, as far as they have come (SPEC 5.5, 7.1). They stay in the kernels' memory. */
export class Codebooks {
  private readonly shapes = new Map<number, ShapeCodebook>();
  private readonly colours = new Map<number, ColourCodebook>();

  constructor(
    private readonly k: Kernels,
    private readonly entries: readonly CodebookEntry[],
  ) {}

  /**
   * Decode a codebook's segment and keep its rows. Nothing else may be reserved while it runs.
   *
   * @param kind - Kind of the segment: 3, or 4 to 6 for the bands.
   */
  add(codebook: number, kind: number, payload: Uint8Array): void {
    const { k } = this;
    const { rows } = this.entries[codebook]!;
    const bottom = k.mark();
    if (kind === SegmentKind.shapeCodebook) {
      const kept = Array.from({ length: 7 }, () => k.alloc(4 * rows));
      const scratch = k.mark();
      try {
        const streams = new Payload(k, payload, rows, "codebook");
        copyColumns(k, readShapeRows(k, streams), kept, rows);
        streams.finish();
      } catch (error) {
        k.release(bottom);
        throw error;
      }
      k.release(scratch);
      this.shapes.set(codebook, { rows, scales: kept.slice(0, 3), quats: kept.slice(3) });
      return;
    }
    const band = kind - SegmentKind.colourBand1;
    const kept = k.alloc(4 * rows * BAND_FLOATS[band]!);
    const scratch = k.mark();
    try {
      const streams = new Payload(k, payload, rows, "codebook");
      const attribute = BAND_ATTRIBUTES[band]!;
      if (streams.has(attribute)) readBand(k, streams.take(attribute), kept);
      else k.u8.fill(0, kept, scratch);
      streams.finish();
    } catch (error) {
      k.release(bottom);
      throw error;
    }
    k.release(scratch);
    const book = this.colours.get(codebook) ?? { rows, bands: [] };
    book.bands[band] = kept;
    this.colours.set(codebook, book);
  }

  /** The shape codebook that a stream names; it must be one that its segment needs. */
  shape(codebook: number, needs: number): ShapeCodebook {
    this.check(codebook, needs, "shape");
    return this.there(this.shapes.get(codebook), codebook);
  }

  /** The colour codebook that a stream names; it must be one that its segment needs. */
  colour(codebook: number, needs: number, degree: number): ColourCodebook {
    this.check(codebook, needs, "colour");
    const book = this.there(this.colours.get(codebook), codebook);
    for (let band = 0; band < degree; band++) this.there(book.bands[band], codebook);
    return book;
  }

  private check(codebook: number, needs: number, attribute: CodebookEntry["attribute"]): void {
    if (codebook >= this.entries.length || ((needs >>> codebook) & 1) === 0) {
      throw new CogsplatError("codebook-missing", `codebook ${codebook} is not among those that the segment needs`);
    }
    if (this.entries[codebook]!.attribute !== attribute) {
      throw new CogsplatError("codebook-missing", `codebook ${codebook} is not one of ${attribute}`);
    }
  }

  private there<T>(part: T | undefined, codebook: number): T {
    if (part === undefined) throw new RangeError(`codebook ${codebook} has not been added`);
    return part;
  }
}

/**
 * Scales and quaternions of a codebook or of escape rows: seven columns.
 *
 * @param escapes - Number of escape rows; undefined for the rows of a codebook.
 */
export function readShapeRows(k: Kernels, payload: Payload, escapes?: number): number[] {
  const take = (attribute: number) =>
    escapes === undefined ? payload.take(attribute) : payload.takeEscape(attribute, escapes);
  const scales = readPlainColumns(k, take(Attribute.scales));
  return [...scales, ...readQuats(k, take(Attribute.quats))];
}

/** Columns of a scalar or float stream. */
export function readPlainColumns(k: Kernels, stream: StreamRecord): number[] {
  return stream.kind === Kind.float ? readFloatStream(k, stream) : readGridStream(k, stream);
}

/** Rows of one SH band. */
export function readBand(k: Kernels, stream: StreamRecord, target: number): void {
  if (stream.kind === Kind.float) readFloatRows(k, stream, target);
  else readScalarRows(k, stream, target);
}

/** The attribute of each SH band from 1. */
export function bandAttributes(degree: number): readonly number[] {
  return BAND_ATTRIBUTES.slice(0, degree);
}

function copyColumns(k: Kernels, from: readonly number[], to: readonly number[], rows: number): void {
  from.forEach((address, i) => {
    k.u8.copyWithin(to[i]!, address, address + 4 * rows);
  });
}
