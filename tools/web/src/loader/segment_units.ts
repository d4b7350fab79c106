import { parentsOf } from "../container/chunk_sets.js";
import type { SceneIndex } from "../container/scene_index.js";
import { SegmentKind } from "../container/tables.js";
import type { Unit } from "../schedule/scheduler.js";

/** What is taken from an index. */
export type UnitIndex = Pick<SceneIndex, "segments" | "chunks" | "range" | "codebookSegmentsOf">;

/** A unit, and the segment that it is. */
export interface SegmentUnit extends Unit {
  readonly segment: number;
}

const OF_CHUNKS: readonly number[] = [SegmentKind.head, SegmentKind.refinement, SegmentKind.tail];
const BANDS: readonly number[] = [SegmentKind.colourBand1, SegmentKind.colourBand2, SegmentKind.colourBand3];

/**
 * The segments that a visitor's pictures need as units of the scheduler (docs/streaming.md, 7), in the order of the file.
 *
 * Chunks that end (SPEC 5.10) are left out, as where chunks are not drawn in the order of the file (SPEC 8.6).
 *
 * @param index - As far as it was read; units that are known stay what they are when more is read.
 * @param degree - Highest SH degree that is wanted.
 * @param compensates - Whether the layers of compensation are wanted.
 */
export function segmentUnits(index: UnitIndex, degree: number, compensates: boolean): SegmentUnit[] {
  const { kind, owner } = index.segments;
  const { until, cell } = index.chunks;
  const isWanted = (segment: number): boolean => {
    const of = kind[segment]!;
    if (OF_CHUNKS.includes(of)) return until[owner[segment]!] === 0 && (of !== SegmentKind.tail || degree > 0);
    if (of === SegmentKind.compensation) return compensates;
    return of === SegmentKind.shapeCodebook || of === SegmentKind.viewTable || BANDS.slice(0, degree).includes(of);
  };
  const segments = Array.from(kind.keys()).filter(isWanted);
  const unitOf = new Map(segments.map((segment, unit) => [segment, unit]));
  const heads = new Map(
    segments.flatMap((segment, unit) => (kind[segment] === SegmentKind.head ? [[owner[segment]!, unit]] : [])),
  );
  const parents = parentsOf(cell);
  return segments.map((segment) => {
    const { offset, length } = index.range(segment);
    const isHead = kind[segment] === SegmentKind.head;
    const chunk = OF_CHUNKS.includes(kind[segment]!) ? owner[segment]! : -1;
    const books = chunk < 0 ? [] : (index.codebookSegmentsOf(segment, degree) ?? []);
    const before = chunk < 0 ? undefined : heads.get(isHead ? parents[chunk]! : chunk);
    const after = [...books.map((book) => unitOf.get(book)), before].filter((unit) => unit !== undefined);
    // The view table says what to choose: it comes first, wherever it is.
    const end = kind[segment] === SegmentKind.viewTable ? length : offset + length;
    return { segment, chunk, isHead, end, size: length, after };
  });
}

/** The units of each chunk. */
export function unitsByChunk(units: readonly SegmentUnit[], chunks: number): number[][] {
  const found: number[][] = Array.from({ length: chunks }, () => []);
  units.forEach(({ chunk }, unit) => {
    if (chunk >= 0) found[chunk]!.push(unit);
  });
  return found;
}
