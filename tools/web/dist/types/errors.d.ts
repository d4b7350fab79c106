/** The four classes of refusals (SPEC 12). */
export type RefusalClass = "format" | "truncated" | "unsupported" | "limit";
/** Every reason code of SPEC 12 with its class and the clause that it is raised for first. */
declare const REASONS: {
    readonly "not-cogs": readonly ["format", "3.1"];
    readonly "preamble-truncated": readonly ["truncated", "3.1"];
    readonly "preamble-crc": readonly ["format", "3.1"];
    readonly "preamble-reserved": readonly ["format", "3.1"];
    readonly "version-major": readonly ["unsupported", "3.2"];
    readonly "version-minor": readonly ["unsupported", "3.2"];
    readonly "root-length": readonly ["format", "3.3"];
    readonly "file-length": readonly ["format", "3.3"];
    readonly "root-truncated": readonly ["truncated", "3.3"];
    readonly "root-crc": readonly ["format", "3.3"];
    readonly "file-truncated": readonly ["truncated", "3.3"];
    readonly "file-trailing": readonly ["format", "3.3"];
    readonly "source-changed": readonly ["truncated", "8.4"];
    readonly "msgpack-truncated": readonly ["format", "4.1"];
    readonly "msgpack-trailing": readonly ["format", "4.1"];
    readonly "msgpack-invalid": readonly ["format", "4.1"];
    readonly "msgpack-depth": readonly ["format", "4.1"];
    readonly "msgpack-count": readonly ["format", "4.1"];
    readonly "msgpack-key": readonly ["format", "4.1"];
    readonly "msgpack-duplicate-key": readonly ["format", "4.1"];
    readonly "msgpack-utf8": readonly ["format", "4.1"];
    readonly "msgpack-integer": readonly ["format", "4.1"];
    readonly "msgpack-canonical": readonly ["format", "4.1"];
    readonly "msgpack-type": readonly ["format", "4.1"];
    readonly "root-missing": readonly ["format", "4.2"];
    readonly "root-type": readonly ["format", "4.2"];
    readonly "root-value": readonly ["format", "4.2"];
    readonly "root-columns": readonly ["format", "5.3"];
    readonly "root-must-understand": readonly ["unsupported", "4.3"];
    readonly "colour-space-unknown": readonly ["unsupported", "4.2"];
    readonly "segments-length": readonly ["format", "5.1"];
    readonly "segment-kind-unknown": readonly ["unsupported", "5.2"];
    readonly "needs-range": readonly ["format", "5.3"];
    readonly "segment-crc": readonly ["format", "5.3"];
    readonly "segment-hash": readonly ["format", "5.3"];
    readonly "segment-missing": readonly ["truncated", "3.4"];
    readonly "segment-object": readonly ["format", "3.4"];
    readonly "places-crc": readonly ["format", "3.4"];
    readonly "places-range": readonly ["format", "3.4"];
    readonly "object-hash": readonly ["format", "3.4"];
    readonly "chunk-box": readonly ["format", "5.4"];
    readonly "chunk-heads": readonly ["format", "5.4"];
    readonly "chunk-tails": readonly ["format", "5.4"];
    readonly "chunk-refinements": readonly ["format", "5.4"];
    readonly "splat-count": readonly ["format", "5.4"];
    readonly "chunk-until": readonly ["format", "5.10"];
    readonly "chunk-opacities": readonly ["format", "5.11"];
    readonly "level-chunks": readonly ["format", "5.11"];
    readonly "codebook-unknown": readonly ["unsupported", "5.5"];
    readonly "codebook-segments": readonly ["format", "5.5"];
    readonly "attribute-type-unknown": readonly ["unsupported", "5.7"];
    readonly "attribute-segments": readonly ["format", "5.7"];
    readonly "attribute-record": readonly ["format", "5.7"];
    readonly "camera-segments": readonly ["format", "5.8"];
    readonly "compensation-segments": readonly ["format", "5.9"];
    readonly "view-table-segments": readonly ["format", "5.12"];
    readonly "page-crc": readonly ["format", "5.6"];
    readonly "page-entry": readonly ["format", "5.6"];
    readonly "segment-count": readonly ["format", "9.1"];
    readonly "stream-record": readonly ["format", "6.2"];
    readonly "stream-count": readonly ["format", "9.1"];
    readonly "stream-attribute-unknown": readonly ["unsupported", "6.2"];
    readonly "stream-kind-unknown": readonly ["unsupported", "6.2"];
    readonly "stream-kind": readonly ["format", "6.2"];
    readonly "stream-rows": readonly ["format", "6.2"];
    readonly "stream-duplicate": readonly ["format", "6.2"];
    readonly "stream-params": readonly ["format", "6.2"];
    readonly "stream-planes": readonly ["format", "6.2"];
    readonly "stream-missing": readonly ["format", "7.2"];
    readonly "stream-unexpected": readonly ["format", "7.2"];
    readonly "plane-length": readonly ["format", "6.3"];
    readonly "plane-radix": readonly ["format", "6.9"];
    readonly "plane-digits": readonly ["format", "6.9"];
    readonly "zstd-frame": readonly ["format", "6.3"];
    readonly "zstd-size": readonly ["format", "6.3"];
    readonly "zstd-window": readonly ["format", "6.3"];
    readonly "zstd-dictionary": readonly ["format", "6.3"];
    readonly "zstd-checksum": readonly ["format", "6.3"];
    readonly "grid-value": readonly ["format", "6.4"];
    readonly "grid-levels": readonly ["format", "6.4"];
    readonly "code-range": readonly ["format", "6.4"];
    readonly "morton-class": readonly ["format", "6.5"];
    readonly "morton-range": readonly ["format", "6.5"];
    readonly "quat-largest": readonly ["format", "6.6"];
    readonly "index-range": readonly ["format", "6.7"];
    readonly "codebook-missing": readonly ["format", "6.7"];
    readonly "float-value": readonly ["format", "6.8"];
    readonly "step-model": readonly ["format", "6.10"];
    readonly "refinement-radix": readonly ["format", "6.16"];
    readonly "refinement-bits": readonly ["format", "6.17"];
    readonly "bits-padding": readonly ["format", "6.5"];
    readonly "basis-value": readonly ["format", "6.13"];
    readonly "basis-width": readonly ["format", "6.14"];
    readonly "decoded-size": readonly ["limit", "9.2"];
};
/** A stable reason code of SPEC 12. */
export type ReasonCode = keyof typeof REASONS;
/** Every reason code and its class. */
export declare const REASON_CODES: ReadonlyMap<ReasonCode, RefusalClass>;
/** A file, a payload or a reader's limit that SPEC.md refuses. */
export declare class CogsplatError extends Error {
    readonly code: ReasonCode;
    readonly detail: string;
    readonly offset: number | undefined;
    /** What kind of refusal this is: `format`, `truncated`, `unsupported` or `limit`. */
    readonly refusal: RefusalClass;
    /** The clause of SPEC.md that the data breaks. */
    readonly clause: string;
    /**
     * @param code - Reason code of SPEC 12.
     * @param detail - What was found and what was expected.
     * @param offset - Byte of the file, page or payload where it was found, where that is known.
     */
    constructor(code: ReasonCode, detail: string, offset?: number | undefined);
}
/** A source of bytes that failed: the network or the disk, not the file's content. */
export declare class SourceError extends Error {
    readonly status: number | undefined;
    readonly retryable: boolean;
    readonly retryAfter: number | undefined;
    /**
     * @param message - What was asked and what came.
     * @param status - HTTP status where there was one.
     * @param retryable - Whether asking again may help.
     * @param retryAfter - Time after which the server wants to be asked again, ms, where it said so.
     */
    constructor(message: string, status?: number | undefined, retryable?: boolean, retryAfter?: number | undefined);
}
export {};
