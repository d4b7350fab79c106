import { parentsOf } from "../container/chunk_sets.js";
import type { SceneIndex } from "../container/scene_index.js";
import { SegmentKind } from "../container/tables.js";
import type { Unit } from "../schedule/scheduler.js";

/** Part of an index that units are made from. */
export type UnitIndex = Pick<SceneIndex, "segments" | "chunks" | "range" | "codebookSegmentsOf">;

/** A unit of the scheduler and its segment. */
export interface SegmentUnit extends Unit {
  readonly segment: number;
}

const OF_CHUNKS: readonly number[] = [SegmentKind.head, SegmentKind.refinement, SegmentKind.tail];
const BANDS: readonly number[] = [SegmentKind.colourBand1, SegmentKind.colourBand2, SegmentKind.colourBand3];

/**
 * Return the segments that pictures need as units of the scheduler (docs/streaming.md, 7), in file order.
 *
 * Chunks that end (SPEC 5.10) are excluded, as in every order but that of the file (SPEC 8.6).
 *
 * @param index - Index; reading more of its pages appends units.
 * @param degree - SH degree to fetch.
 * @param compensates - Whether to fetch the layers of compensation.
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
    const dependencies = [...books.map((book) => unitOf.get(book)), before].filter((unit) => unit !== undefined);
    // The view table decides the order, so it counts as the beginning of the file.
    const end = kind[segment] === SegmentKind.viewTable ? length : offset + length;
    return { segment, chunk, isHead, end, size: length, dependencies };
  });
}

/** Return the units of each chunk. */
export function unitsByChunk(units: readonly SegmentUnit[], chunks: number): number[][] {
  const found: number[][] = Array.from({ length: chunks }, () => []);
  units.forEach(({ chunk }, unit) => {
    if (chunk >= 0) found[chunk]!.push(unit);
  });
  return found;
}
