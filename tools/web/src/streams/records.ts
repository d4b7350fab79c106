import { CogsplatError } from "../errors.js";
import type { Kernels } from "../kernels/kernels.js";
import { storedBytes, type StoredPlane } from "./planes.js";

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
/** Most streams of a payload (SPEC 6.1). */
const MAX_STREAMS = 64;
const RECORD_BYTES = 12;

interface AttributeRule {
  readonly name: string;
  readonly components: number;
  readonly kinds: readonly number[];
}

/** The table of attributes of SPEC 6.2. */
const RULES: ReadonlyMap<number, AttributeRule> = new Map<number, AttributeRule>([
  [Attribute.means, { name: "means", components: 3, kinds: [Kind.scalar, Kind.float, Kind.sorted, Kind.bits] }],
  [Attribute.opacities, { name: "opacities", components: 1, kinds: [Kind.scalar, Kind.float, Kind.digits] }],
  [Attribute.sh0, { name: "sh0", components: 3, kinds: [Kind.scalar, Kind.float, Kind.basis, Kind.digits] }],
  [Attribute.scales, { name: "scales", components: 3, kinds: [Kind.scalar, Kind.float, Kind.differences, Kind.digits] }],
  [Attribute.quats, { name: "quats", components: 4, kinds: [Kind.quat, Kind.swingTwist] }],
  [Attribute.scaleFactor, { name: "scale factor", components: 1, kinds: [Kind.scalar, Kind.float] }],
  [Attribute.shape, { name: "shape", components: 7, kinds: [Kind.vq] }],
  [Attribute.shN, { name: "shN", components: 45, kinds: [Kind.vq, Kind.basis] }],
  [Attribute.sh1, { name: "sh1", components: 9, kinds: [Kind.scalar, Kind.float] }],
  [Attribute.sh2, { name: "sh2", components: 15, kinds: [Kind.scalar, Kind.float] }],
  [Attribute.sh3, { name: "sh3", components: 21, kinds: [Kind.scalar, Kind.float] }],
]);
/** Attributes that a refinement may have (SPEC 7.4). */
const REFINABLE = new Set<number>([Attribute.means, Attribute.opacities, Attribute.sh0, Attribute.scales]);
const KNOWN_KINDS = new Set<number>(Object.values(Kind));

/** One stream of a payload: its record, its parameters and its planes. */
export interface StreamRecord {
  readonly attribute: number;
  readonly name: string;
  readonly kind: number;
  readonly components: number;
  /** Whether the rows are escape rows, which a vq stream of the same payload refers to. */
  readonly escape: boolean;
  readonly infinities: boolean;
  readonly rows: number;
  readonly params: DataView;
  readonly planes: readonly StoredPlane[];
}

/** What a payload belongs to: refinements have kinds of their own. */
export type Place = "head" | "tail" | "codebook" | "refinement";

/** The streams of one payload; a clause takes those that it names, and others are refused. */
export class Payload {
  private readonly streams = new Map<string, StreamRecord>();

  /**
   * Copy a payload into the kernels' memory and read its records.
   *
   * @param k - Memory that receives the payload.
   * @param bytes - The payload; its CRC was checked.
   * @param rows - Rows of the chunk or codebook, the most that a stream may have.
   * @param place - What the payload belongs to.
   */
  constructor(k: Kernels, bytes: Uint8Array, rows: number, private readonly place: Place) {
    const base = k.alloc(bytes.length);
    k.u8.set(bytes, base);
    for (const stream of readRecords(bytes, base, rows)) {
      const refines = stream.kind === Kind.digits || stream.kind === Kind.bits;
      const key = keyOf(stream.attribute, stream.escape);
      const refinable = REFINABLE.has(stream.attribute) && !stream.escape;
      if (place === "refinement" && !refinable) {
        throw new CogsplatError("stream-unexpected", `a refinement has a stream of ${stream.name}`);
      }
      if (!RULES.get(stream.attribute)!.kinds.includes(stream.kind)) {
        throw new CogsplatError("stream-kind", `${stream.name} of kind ${stream.kind}`);
      }
      if (this.streams.has(key)) throw new CogsplatError("stream-duplicate", `${stream.name} twice`);
      if (refines && place !== "refinement") {
        throw new CogsplatError("stream-kind", `${stream.name} of a ${place} are of kind ${stream.kind}`);
      }
      this.streams.set(key, stream);
    }
  }

  /** The stream of an attribute, where there is one. */
  find(attribute: number, escape = false): StreamRecord | undefined {
    return this.streams.get(keyOf(attribute, escape));
  }

  /** The stream of an attribute that must be there. */
  get(attribute: number, escape = false): StreamRecord {
    const stream = this.find(attribute, escape);
    if (stream === undefined) {
      const name = RULES.get(attribute)!.name;
      throw new CogsplatError("stream-missing", `the ${this.place} has no ${escape ? "escape rows of " : ""}${name}`);
    }
    return stream;
  }

  /**
   * Refuse what has no place here; called once the streams that must be there were seen to be.
   *
   * @param attributes - What may be there without the flag escape.
   * @param escapes - What may be there with it.
   */
  only(attributes: readonly number[], escapes: readonly number[] = []): void {
    for (const stream of this.streams.values()) {
      if (!(stream.escape ? escapes : attributes).includes(stream.attribute)) {
        const rows = stream.escape ? "escape rows of " : "";
        throw new CogsplatError("stream-unexpected", `the ${this.place} has a stream of ${rows}${stream.name}`);
      }
    }
  }
}

function keyOf(attribute: number, escape: boolean): string {
  return `${attribute}${escape ? "e" : ""}`;
}

function readRecords(bytes: Uint8Array, base: number, most: number): StreamRecord[] {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const leaves = (end: number, what: string, start: number) => {
    if (end > bytes.length) throw new CogsplatError("stream-record", `${what} leaves the payload`, start);
  };
  leaves(2, "the number of streams", 0);
  const count = view.getUint16(0, true);
  if (count > MAX_STREAMS) throw new CogsplatError("stream-count", `${count} streams`, 0);
  const records: { at: number; words: number; planes: number }[] = [];
  let at = 2;
  for (let i = 0; i < count; i++) {
    leaves(at + RECORD_BYTES, `record ${i}`, at);
    const planes = view.getUint16(at + 8, true);
    const words = at + RECORD_BYTES + view.getUint16(at + 10, true);
    leaves(words + 4 * planes, `record ${i}`, at);
    records.push({ at, words, planes });
    at = words + 4 * planes;
  }
  const streams = records.map((record) => {
    const planes: StoredPlane[] = [];
    for (let i = 0; i < record.planes; i++) {
      const word = view.getUint32(record.words + 4 * i, true);
      leaves(at + storedBytes(word), `plane ${i}`, at);
      planes.push({ word, address: base + at });
      at += storedBytes(word);
    }
    return readRecord(view, record.at, record.words, planes, most);
  });
  if (at !== bytes.length) throw new CogsplatError("stream-record", `${bytes.length - at} bytes behind the planes`, at);
  return streams;
}

function readRecord(
  view: DataView, at: number, words: number, planes: readonly StoredPlane[], most: number,
): StreamRecord {
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
  if ((flags & ~(FLAG_ESCAPE | FLAG_INFINITIES)) !== 0) throw new CogsplatError("stream-record", `flags ${flags}`, at + 3);
  if (infinities && (attribute !== Attribute.opacities || kind !== Kind.scalar)) {
    throw new CogsplatError("stream-record", `infinities in ${rule.name}`, at + 3);
  }
  if (rows > most) throw new CogsplatError("stream-rows", `${rows} rows of ${rule.name}, at most ${most}`, at + 4);
  const params = new DataView(view.buffer, view.byteOffset + at + RECORD_BYTES, words - at - RECORD_BYTES);
  return {
    attribute, name: rule.name, kind, components, escape: (flags & FLAG_ESCAPE) !== 0, infinities, rows, params, planes,
  };
}

/** Refuse parameters of another length than the kind implies. */
export function checkParams(stream: StreamRecord, bytes: number): void {
  if (stream.params.byteLength !== bytes) {
    throw new CogsplatError("stream-params", `${stream.name}: ${stream.params.byteLength} bytes of parameters, not ${bytes}`);
  }
}

/** Refuse another number of planes than the parameters imply. */
export function checkPlanes(stream: StreamRecord, planes: number): void {
  if (stream.planes.length !== planes) {
    throw new CogsplatError("stream-planes", `${stream.name}: ${stream.planes.length} planes, not ${planes}`);
  }
}

/** Refuse another number of rows than the stream's place has. */
export function checkRows(stream: StreamRecord, rows: number): void {
  if (stream.rows !== rows) throw new CogsplatError("stream-rows", `${stream.name}: ${stream.rows} rows, not ${rows}`);
}

/** Refuse a kind that the attribute has elsewhere but not in this place. */
export function checkKind(stream: StreamRecord, kinds: readonly number[]): void {
  if (!kinds.includes(stream.kind)) throw new CogsplatError("stream-kind", `${stream.name} of kind ${stream.kind} here`);
}
