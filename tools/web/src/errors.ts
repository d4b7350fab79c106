/** Class of a refusal (SPEC 12). */
export type RefusalClass = "format" | "truncated" | "unsupported" | "limit";

/** Reason codes of SPEC 12, each with its class and its first clause. */
const REASONS = {
  "not-cogs": ["format", "3.1"],
  "preamble-truncated": ["truncated", "3.1"],
  "preamble-crc": ["format", "3.1"],
  "preamble-reserved": ["format", "3.1"],
  "version-major": ["unsupported", "3.2"],
  "version-minor": ["unsupported", "3.2"],
  "root-length": ["format", "3.3"],
  "file-length": ["format", "3.3"],
  "root-truncated": ["truncated", "3.3"],
  "root-crc": ["format", "3.3"],
  "file-truncated": ["truncated", "3.3"],
  "file-trailing": ["format", "3.3"],
  "source-changed": ["truncated", "8.4"],
  "msgpack-truncated": ["format", "4.1"],
  "msgpack-trailing": ["format", "4.1"],
  "msgpack-invalid": ["format", "4.1"],
  "msgpack-depth": ["format", "4.1"],
  "msgpack-count": ["format", "4.1"],
  "msgpack-key": ["format", "4.1"],
  "msgpack-duplicate-key": ["format", "4.1"],
  "msgpack-utf8": ["format", "4.1"],
  "msgpack-integer": ["format", "4.1"],
  "msgpack-canonical": ["format", "4.1"],
  "msgpack-type": ["format", "4.1"],
  "root-missing": ["format", "4.2"],
  "root-type": ["format", "4.2"],
  "root-value": ["format", "4.2"],
  "root-columns": ["format", "5.3"],
  "root-must-understand": ["unsupported", "4.3"],
  "colour-space-unknown": ["unsupported", "4.2"],
  "segments-length": ["format", "5.1"],
  "segment-kind-unknown": ["unsupported", "5.2"],
  "needs-range": ["format", "5.3"],
  "segment-crc": ["format", "5.3"],
  "segment-hash": ["format", "5.3"],
  "segment-missing": ["truncated", "3.4"],
  "segment-object": ["format", "3.4"],
  "places-crc": ["format", "3.4"],
  "places-range": ["format", "3.4"],
  "object-hash": ["format", "3.4"],
  "chunk-box": ["format", "5.4"],
  "chunk-heads": ["format", "5.4"],
  "chunk-tails": ["format", "5.4"],
  "chunk-refinements": ["format", "5.4"],
  "splat-count": ["format", "5.4"],
  "chunk-until": ["format", "5.10"],
  "chunk-opacities": ["format", "5.11"],
  "level-chunks": ["format", "5.11"],
  "codebook-unknown": ["unsupported", "5.5"],
  "codebook-segments": ["format", "5.5"],
  "attribute-type-unknown": ["unsupported", "5.7"],
  "attribute-segments": ["format", "5.7"],
  "attribute-record": ["format", "5.7"],
  "camera-segments": ["format", "5.8"],
  "compensation-segments": ["format", "5.9"],
  "view-table-segments": ["format", "5.12"],
  "description-segments": ["format", "5.13"],
  "picture-header": ["format", "5.14"],
  "page-crc": ["format", "5.6"],
  "page-entry": ["format", "5.6"],
  "segment-count": ["format", "9.1"],
  "stream-record": ["format", "6.2"],
  "stream-count": ["format", "9.1"],
  "stream-attribute-unknown": ["unsupported", "6.2"],
  "stream-kind-unknown": ["unsupported", "6.2"],
  "stream-kind": ["format", "6.2"],
  "stream-rows": ["format", "6.2"],
  "stream-duplicate": ["format", "6.2"],
  "stream-params": ["format", "6.2"],
  "stream-planes": ["format", "6.2"],
  "stream-missing": ["format", "7.2"],
  "stream-unexpected": ["format", "7.2"],
  "plane-length": ["format", "6.3"],
  "plane-radix": ["format", "6.9"],
  "plane-digits": ["format", "6.9"],
  "zstd-frame": ["format", "6.3"],
  "zstd-size": ["format", "6.3"],
  "zstd-window": ["format", "6.3"],
  "zstd-dictionary": ["format", "6.3"],
  "zstd-checksum": ["format", "6.3"],
  "grid-value": ["format", "6.4"],
  "grid-levels": ["format", "6.4"],
  "code-range": ["format", "6.4"],
  "morton-class": ["format", "6.5"],
  "morton-range": ["format", "6.5"],
  "quat-largest": ["format", "6.6"],
  "index-range": ["format", "6.7"],
  "codebook-missing": ["format", "6.7"],
  "float-value": ["format", "6.8"],
  "step-model": ["format", "6.10"],
  "refinement-radix": ["format", "6.16"],
  "refinement-bits": ["format", "6.17"],
  "bits-padding": ["format", "6.5"],
  "basis-value": ["format", "6.13"],
  "basis-width": ["format", "6.14"],
  "decoded-size": ["limit", "9.2"],
} as const satisfies Record<string, readonly [RefusalClass, string]>;

/** A stable reason code of SPEC 12. */
export type ReasonCode = keyof typeof REASONS;

/** Reason codes and their classes. */
export const REASON_CODES: ReadonlyMap<ReasonCode, RefusalClass> = new Map(
  Object.entries(REASONS).map(([code, [refusal]]) => [code as ReasonCode, refusal]),
);

/** Error of a file, a payload or a limit that SPEC.md refuses. */
export class CogsplatError extends Error {
  /** Class of the refusal: `format`, `truncated`, `unsupported` or `limit`. */
  readonly refusal: RefusalClass;
  /** The clause of SPEC.md that the data breaks. */
  readonly clause: string;

  /**
   * @param code - Reason code of SPEC 12.
   * @param detail - Found and expected values.
   * @param offset - Byte offset of the fault in the file, page or payload, if known.
   */
  constructor(
    readonly code: ReasonCode,
    readonly detail: string,
    readonly offset: number | undefined = undefined,
  ) {
    const [refusal, clause] = REASONS[code];
    super(`${detail}${offset === undefined ? "" : ` at byte ${offset}`} (${code}, SPEC ${clause})`);
    this.name = "CogsplatError";
    this.refusal = refusal;
    this.clause = clause;
  }
}

/** Error of a source of bytes: the network or the disk, not the content of the file. */
export class SourceError extends Error {
  /**
   * @param message - The request and the failure.
   * @param status - HTTP status, if any.
   * @param retryable - Whether a retry may succeed.
   * @param retryAfter - Wait that the server requested, ms, if any.
   */
  constructor(
    message: string,
    readonly status: number | undefined = undefined,
    readonly retryable = false,
    readonly retryAfter: number | undefined = undefined,
  ) {
    super(message);
    this.name = "SourceError";
  }
}
