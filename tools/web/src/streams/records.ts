import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { type StoredPlane, storedBytes } from "./planes.js";

/** Attributes of SPEC 6.2. */
export const Attribute = {
  means: 1,
  opacities: 2,
  sh0: 3,
  scales: 4,
  quats: 5,
  scaleFactor: 6,
  shape: 7,
  shN: 8,
  sh1: 9,
  sh2: 10,
  sh3: 11,
} as const;

/** Stream kinds of SPEC 6.2. */
export const Kind = {
  scalar: 1,
  float: 2,
  quat: 3,
  vq: 4,
  sorted: 5,
  differences: 6,
  swingTwist: 7,
  basis: 8,
  digits: 9,
  bits: 10,
} as const;

const FLAG_ESCAPE = 1;
const FLAG_INFINITIES = 2;
/** Streams of a payload at most (SPEC 6.1). */
const MAX_STREAMS = 64;
const RECORD_BYTES = 12;

interface AttributeRule {
  readonly name: string;
  readonly components: number;
  readonly kinds: readonly number[];
}

const PLAIN = [Kind.scalar, Kind.float];
/** Rules for the attributes of SPEC 6.2 except digits and bits, which only refinements have. */
const RULES: ReadonlyMap<number, AttributeRule> = new Map<number, AttributeRule>([
  [Attribute.means, { name: "means", components: 3, kinds: [...PLAIN, Kind.sorted] }],
  [Attribute.opacities, { name: "opacities", components: 1, kinds: [...PLAIN, Kind.differences] }],
  [Attribute.sh0, { name: "sh0", components: 3, kinds: [...PLAIN, Kind.basis] }],
  [Attribute.scales, { name: "scales", components: 3, kinds: [...PLAIN, Kind.differences] }],
  [Attribute.quats, { name: "quats", components: 4, kinds: [Kind.quat, Kind.swingTwist] }],
  [Attribute.scaleFactor, { name: "scale factor", components: 1, kinds: PLAIN }],
  [Attribute.shape, { name: "shape", components: 7, kinds: [Kind.vq] }],
  [Attribute.shN, { name: "shN", components: 45, kinds: [Kind.vq, Kind.basis] }],
  [Attribute.sh1, { name: "sh1", components: 9, kinds: PLAIN }],
  [Attribute.sh2, { name: "sh2", components: 15, kinds: PLAIN }],
  [Attribute.sh3, { name: "sh3", components: 21, kinds: PLAIN }],
]);
/** Attributes whose grid codes a refinement may extend by digits (SPEC 6.16). */
const WITH_DIGITS: readonly number[] = [Attribute.opacities, Attribute.sh0, Attribute.scales];
const KNOWN_KINDS = new Set<number>(Object.values(Kind));

/** A stream of a payload: record, parameters and planes. */
export interface StreamRecord {
  readonly attribute: number;
  readonly name: string;
  readonly kind: number;
  readonly components: number;
  /** Whether the rows are escape rows, to which a vq stream of the payload refers. */
  readonly isEscape: boolean;
  readonly infinities: boolean;
  readonly rows: number;
  readonly params: DataView;
  readonly planes: readonly StoredPlane[];
}

/** Owner of a payload; the kinds allowed differ. */
export type Place = "head" | "tail" | "codebook" | "refinement" | "opacities";

/** The streams of one payload, read in the order of a clause of SPEC 7; unread streams are refused. */
export class Payload {
  private readonly streams = new Map<string, StreamRecord>();

  /**
   * Copy a payload into the kernels' memory and read its records.
   *
   * @param k - Kernels whose memory receives the payload.
   * @param bytes - The payload, whose CRC was checked.
   * @param rows - Rows of the chunk or codebook, the upper bound for its streams.
   * @param place - Owner of the payload.
   */
  constructor(
    k: Kernels,
    bytes: Uint8Array,
    private readonly rows: number,
    private readonly place: Place,
  ) {
    const base = k.alloc(bytes.length);
    k.u8.set(bytes, base);
    for (const stream of readRecords(bytes, base, rows))
      this.streams.set(keyOf(stream.attribute, stream.isEscape), stream);
  }

  /** Return whether a stream of an attribute is present and unread. */
  has(attribute: number, isEscape = false): boolean {
    return this.streams.has(keyOf(attribute, isEscape));
  }

  /** Return the stream of a required attribute, with one row per row of the payload. */
  take(attribute: number): StreamRecord {
    return this.takeRows(attribute, false, this.rows);
  }

  /** Return the escape rows of a required attribute, exactly `rows`. */
  takeEscape(attribute: number, rows: number): StreamRecord {
    return this.takeRows(attribute, true, rows);
  }

  private takeRows(attribute: number, isEscape: boolean, rows: number): StreamRecord {
    const stream = this.streams.get(keyOf(attribute, isEscape));
    const { name, kinds } = RULES.get(attribute)!;
    if (stream === undefined) {
      throw new CogsplatError("stream-missing", `the ${this.place} has no ${isEscape ? "escape rows of " : ""}${name}`);
    }
    this.streams.delete(keyOf(attribute, isEscape));
    checkRows(stream, rows);
    // Differences of opacities are in later levels alone (SPEC 6.2).
    const isElsewhere =
      attribute === Attribute.opacities && stream.kind === Kind.differences && this.place !== "opacities";
    if (!kinds.includes(stream.kind) || isElsewhere) {
      throw new CogsplatError("stream-kind", `${name} of kind ${stream.kind} in a ${this.place}`);
    }
    return stream;
  }

  /** Return the stream of a refinement that refines a stream of the head, if any (SPEC 7.4). */
  takeRefining(head: StreamRecord): StreamRecord | undefined {
    const stream = this.streams.get(keyOf(head.attribute, false));
    if (stream === undefined) return undefined;
    this.streams.delete(keyOf(head.attribute, false));
    checkRows(stream, this.rows);
    if (stream.kind !== refinedBy(head)) {
      throw new CogsplatError("stream-kind", `${stream.name} of kind ${stream.kind} for a stream of kind ${head.kind}`);
    }
    return stream;
  }

  /** Refuse unread streams. */
  finish(): void {
    for (const stream of this.streams.values()) {
      const rows = stream.isEscape ? "escape rows of " : "";
      throw new CogsplatError("stream-unexpected", `the ${this.place} has a stream of ${rows}${stream.name}`);
    }
  }
}

/** Return the kind that refines a stream of a head; undefined for a stream that cannot be refined (SPEC 7.4). */
function refinedBy({ attribute, kind, infinities }: StreamRecord): number | undefined {
  if (kind === Kind.sorted) return Kind.bits;
  const isOnGrid = kind === Kind.scalar || kind === Kind.differences || kind === Kind.basis;
  return isOnGrid && !infinities && WITH_DIGITS.includes(attribute) ? Kind.digits : undefined;
}

function keyOf(attribute: number, isEscape: boolean): string {
  return `${attribute}${isEscape ? "e" : ""}`;
}

function readRecords(bytes: Uint8Array, base: number, most: number): StreamRecord[] {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const leaves = (end: number, what: string, start: number) => {
    if (end > bytes.length) throw new CogsplatError("stream-record", `${what} leaves the payload`, start);
  };
  leaves(2, "the number of streams", 0);
  const count = view.getUint16(0, true);
  if (count > MAX_STREAMS) throw new CogsplatError("stream-count", `${count} streams`, 0);
  const records: Omit<StreamRecord, "planes">[] = [];
  const words: { at: number; planes: number }[] = [];
  const seen = new Set<string>();
  let at = 2;
  for (let i = 0; i < count; i++) {
    leaves(at + RECORD_BYTES, `record ${i}`, at);
    const planes = view.getUint16(at + 8, true);
    const params = view.getUint16(at + 10, true);
    const wordsAt = at + RECORD_BYTES + params;
    leaves(wordsAt + 4 * planes, `record ${i}`, at);
    const record = readRecord(view, at, params, most);
    const key = keyOf(record.attribute, record.isEscape);
    if (seen.has(key)) throw new CogsplatError("stream-duplicate", `${record.name} twice`, at);
    seen.add(key);
    records.push(record);
    words.push({ at: wordsAt, planes });
    at = wordsAt + 4 * planes;
  }
  const streams = records.map((record, r) => {
    const planes = Array.from({ length: words[r]!.planes }, (_, i): StoredPlane => {
      const word = view.getUint32(words[r]!.at + 4 * i, true);
      const start = at;
      at += storedBytes(word);
      leaves(at, `plane ${i} of ${record.name}`, start);
      return { word, address: base + start };
    });
    return { ...record, planes };
  });
  if (at !== bytes.length) throw new CogsplatError("stream-record", `${bytes.length - at} bytes after the planes`, at);
  return streams;
}

function readRecord(view: DataView, at: number, paramBytes: number, most: number): Omit<StreamRecord, "planes"> {
  const attribute = view.getUint8(at);
  const kind = view.getUint8(at + 1);
  const components = view.getUint8(at + 2);
  const flags = view.getUint8(at + 3);
  const rows = view.getUint32(at + 4, true);
  const rule = RULES.get(attribute);
  if (rule === undefined) throw new CogsplatError("stream-attribute-unknown", `attribute ${attribute}`, at);
  if (!KNOWN_KINDS.has(kind)) throw new CogsplatError("stream-kind-unknown", `kind ${kind}`, at + 1);
  if (components !== rule.components) {
    throw new CogsplatError("stream-record", `${rule.name} of ${components} components`, at + 2);
  }
  const infinities = (flags & FLAG_INFINITIES) !== 0;
  if ((flags & ~(FLAG_ESCAPE | FLAG_INFINITIES)) !== 0)
    throw new CogsplatError("stream-record", `flags ${flags}`, at + 3);
  if (infinities && (attribute !== Attribute.opacities || kind !== Kind.scalar)) {
    throw new CogsplatError("stream-record", `infinities in ${rule.name}`, at + 3);
  }
  if (rows > most) throw new CogsplatError("stream-rows", `${rows} rows of ${rule.name}, at most ${most}`, at + 4);
  const params = new DataView(view.buffer, view.byteOffset + at + RECORD_BYTES, paramBytes);
  return {
    attribute,
    name: rule.name,
    kind,
    components,
    isEscape: (flags & FLAG_ESCAPE) !== 0,
    infinities,
    rows,
    params,
  };
}

/** Refuse parameters whose length differs from that of the kind. */
export function checkParams(stream: StreamRecord, bytes: number): void {
  if (stream.params.byteLength !== bytes) {
    throw new CogsplatError(
      "stream-params",
      `${stream.name}: ${stream.params.byteLength} bytes of parameters, not ${bytes}`,
    );
  }
}

/** Refuse a number of planes that differs from that of the parameters. */
export function checkPlanes(stream: StreamRecord, planes: number): void {
  if (stream.planes.length !== planes) {
    throw new CogsplatError("stream-planes", `${stream.name}: ${stream.planes.length} planes, not ${planes}`);
  }
}

function checkRows(stream: StreamRecord, rows: number): void {
  if (stream.rows !== rows) throw new CogsplatError("stream-rows", `${stream.name}: ${stream.rows} rows, not ${rows}`);
}
