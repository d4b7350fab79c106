import type { CodebookEntry } from "../container/root.js";
import { SegmentKind } from "../container/tables.js";
import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { readFloatRows, readFloatStream } from "../streams/float_streams.js";
import { readGridStream, readScalarRows } from "../streams/grid_streams.js";
import { readQuats, readSwingTwist } from "../streams/quat_streams.js";
import { Attribute, Kind, Payload, type StreamRecord } from "../streams/records.js";

/** Values per row of each SH band: coefficients times channels. */
export const BAND_FLOATS = [9, 15, 21] as const;
const BAND_ATTRIBUTES = [Attribute.sh1, Attribute.sh2, Attribute.sh3] as const;

/** Rows of a shape codebook: three columns of scales, four of quaternions. */
export interface ShapeCodebook {
  readonly rows: number;
  readonly scales: readonly number[];
  readonly quats: readonly number[];
}

/** Rows of a colour codebook: the address of each band present. */
export interface ColourCodebook {
  readonly rows: number;
  readonly bands: (number | undefined)[];
}

/** Codebooks of a scene received so far, in the kernels' memory (SPEC 5.5, 7.1). */
export class Codebooks {
  private readonly shapes = new Map<number, ShapeCodebook>();
  private readonly colours = new Map<number, ColourCodebook>();

  constructor(
    private readonly k: Kernels,
    private readonly entries: readonly CodebookEntry[],
  ) {}

  /**
   * Decode the segment of a codebook and keep its rows; no memory may be reserved meanwhile.
   *
   * @param kind - Segment kind: 3 for shapes, 4 to 6 for colour bands.
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

  /** Return the shape codebook of a stream, which must be among the needs of its segment. */
  shape(codebook: number, needs: number): ShapeCodebook {
    this.check(codebook, needs, "shape");
    return this.there(this.shapes.get(codebook), codebook);
  }

  /** Return the colour codebook of a stream, which must be among the needs of its segment. */
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
 * Read scales and quaternions of a codebook or of escape rows, as seven columns.
 *
 * @param escapes - Number of escape rows; undefined for the rows of a codebook.
 */
export function readShapeRows(k: Kernels, payload: Payload, escapes?: number): number[] {
  const take = (attribute: number) =>
    escapes === undefined ? payload.take(attribute) : payload.takeEscape(attribute, escapes);
  const scales = readPlainColumns(k, take(Attribute.scales));
  const quats = take(Attribute.quats);
  return [...scales, ...(quats.kind === Kind.swingTwist ? readSwingTwist(k, quats, scales) : readQuats(k, quats))];
}

/** Read the columns of a scalar or float stream. */
export function readPlainColumns(k: Kernels, stream: StreamRecord): number[] {
  return stream.kind === Kind.float ? readFloatStream(k, stream) : readGridStream(k, stream);
}

/** Read the rows of one SH band. */
export function readBand(k: Kernels, stream: StreamRecord, target: number): void {
  if (stream.kind === Kind.float) readFloatRows(k, stream, target);
  else readScalarRows(k, stream, target);
}

/** Return the attribute of each SH band, from 1 to a degree. */
export function bandAttributes(degree: number): readonly number[] {
  return BAND_ATTRIBUTES.slice(0, degree);
}

function copyColumns(k: Kernels, from: readonly number[], to: readonly number[], rows: number): void {
  from.forEach((address, i) => {
    k.u8.copyWithin(to[i]!, address, address + 4 * rows);
  });
}
