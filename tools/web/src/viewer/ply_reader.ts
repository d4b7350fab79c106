import { LONGEST_PAUSE, lateness, lengthOf, readParts, withinPause } from "../loader/byte_source.js";
import { type PackedSplats, type PackRanges, SH_WORDS } from "../scene/packed_splats.js";
import type { Meter } from "./meter.js";
import { type PlyLayout, readPlyHeader } from "./ply_header.js";
import type { PlyRequest, PlyResponse } from "./ply_messages.js";
import { packBand, packSplats } from "./ply_packing.js";

/** Rows packed and posted at a time, which takes a few milliseconds. */
const ROWS = 4096;
/** Columns of a splat before its SH bands above DC. */
const COLUMNS = 14;
/** First coefficient, values and bits of each packed band. */
const BANDS = [
  [0, 9, 7],
  [9, 15, 8],
  [24, 21, 6],
] as const;

type Post = (response: PlyResponse, transfer: ArrayBuffer[]) => void;

/**
 * Read a PLY of 3DGS training as its bytes arrive, and post it as packed rows.
 *
 * @param meter - Limits the rate of the bytes.
 * @param rest - Awaited between two blocks of rows.
 */
export async function readPly(
  request: PlyRequest,
  meter: Meter,
  post: Post,
  rest = async (): Promise<void> => undefined,
): Promise<void> {
  try {
    const { stream, totalBytes } = await bytesOf(request.source);
    await new PlyRows(request, totalBytes, post, rest).read(meter.through(readParts(stream, undefined, LONGEST_PAUSE)));
  } catch (error) {
    const status = error instanceof StatusError ? error.status : undefined;
    post({ type: "failed", status, message: error instanceof Error ? error.message : String(error) }, []);
  }
}

/** Error of an HTTP status. */
class StatusError extends Error {
  constructor(readonly status: number) {
    super(`The server answered with status ${status}.`);
  }
}

async function bytesOf(
  source: Blob | string,
): Promise<{ stream: ReadableStream<Uint8Array>; totalBytes: number | undefined }> {
  if (typeof source !== "string") return { stream: source.stream(), totalBytes: source.size };
  const response = await withinPause(fetch(source), LONGEST_PAUSE, () => lateness(LONGEST_PAUSE));
  if (!response.ok || response.body === null) throw new StatusError(response.status);
  return { stream: response.body, totalBytes: lengthOf(response.headers) };
}

/** Converts the bytes of one PLY to packed rows. */
class PlyRows {
  private layout: PlyLayout | undefined;
  private pending = new Uint8Array(0);
  private row = 0;
  private bytes = 0;

  constructor(
    private readonly request: PlyRequest,
    private readonly totalBytes: number | undefined,
    private readonly post: Post,
    private readonly rest: () => Promise<void>,
  ) {}

  async read(stream: AsyncIterable<Uint8Array>): Promise<void> {
    const parts: Uint8Array[] = [];
    let waiting = 0;
    for await (const part of stream) {
      parts.push(part);
      waiting += part.length;
      this.bytes += part.length;
      if (this.layout !== undefined && this.pending.length + waiting < ROWS * this.layout.stride) continue;
      this.pending = concatenateBytes([this.pending, ...parts.splice(0)]);
      waiting = 0;
      await this.packBlocks(false);
      // The rest of the file, perhaps without end, is not needed.
      if (this.layout !== undefined && this.row === this.wantedRows) break;
    }
    this.pending = concatenateBytes([this.pending, ...parts]);
    await this.packBlocks(true);
    if (this.layout === undefined) throw new Error("This PLY ends within its header.");
    if (this.row < this.wantedRows) {
      throw new Error(
        `This PLY ends early: ${this.row.toLocaleString()} of ${this.layout.scene.splats.toLocaleString()} splats are present.`,
      );
    }
    this.post({ type: "end", bytes: this.bytes }, []);
  }

  private get wantedRows(): number {
    return Math.min(this.layout!.scene.splats, this.request.mostRows);
  }

  /** Pack complete blocks; at the end also a partial one. */
  private async packBlocks(last: boolean): Promise<void> {
    if (this.layout === undefined) {
      this.layout = readPlyHeader(this.pending);
      if (this.layout === undefined) return;
      this.pending = this.pending.subarray(this.layout.headerBytes);
    }
    const { layout } = this;
    for (;;) {
      const rows = Math.min(Math.floor(this.pending.length / layout.stride), ROWS, this.wantedRows - this.row);
      if (rows === 0 || (rows < ROWS && !last && this.row + rows < this.wantedRows)) return;
      const values = valuesOf(this.pending, layout, rows);
      if (this.row === 0) this.post({ type: "scene", scene: layout.scene, totalBytes: this.totalBytes }, []);
      const packed = pack(values, layout, rows, this.request.ranges);
      const buffers = [packed.words, packed.means, ...packed.sh].map((array) => array.buffer as ArrayBuffer);
      this.post({ type: "rows", firstRow: this.row, packed, bytes: this.bytes }, buffers);
      this.pending = this.pending.subarray(rows * layout.stride);
      this.row += rows;
      await this.rest();
    }
  }
}

/** Return the values of some rows, in the order of the layout's columns. */
function valuesOf(bytes: Uint8Array, layout: PlyLayout, rows: number): Float32Array {
  const { stride, columns } = layout;
  const width = columns.length;
  const values = new Float32Array(rows * width);
  if (stride % 4 === 0 && columns.every((offset) => offset % 4 === 0)) {
    // A copy is aligned for floats; most files contain floats alone.
    const floats = new Float32Array(bytes.slice(0, rows * stride).buffer);
    const places = Uint32Array.from(columns, (offset) => offset / 4);
    for (let row = 0, at = 0, first = 0; row < rows; row++, first += stride / 4) {
      for (let column = 0; column < width; column++) values[at++] = floats[first + places[column]!]!;
    }
    return values;
  }
  const view = new DataView(bytes.buffer, bytes.byteOffset, rows * stride);
  for (let row = 0, at = 0; row < rows; row++) {
    for (const offset of columns) values[at++] = view.getFloat32(row * stride + offset, true);
  }
  return values;
}

function pack(values: Float32Array, layout: PlyLayout, rows: number, ranges: PackRanges): PackedSplats {
  const width = layout.columns.length;
  const columns = Array.from({ length: COLUMNS }, (_, column) => {
    const target = new Float32Array(rows);
    for (let row = 0, at = column; row < rows; row++, at += width) target[row] = values[at]!;
    return target;
  });
  normalise(columns.slice(6, 10) as [Float32Array, Float32Array, Float32Array, Float32Array], rows);
  const words = new Uint32Array(4 * rows);
  packSplats(columns, rows, ranges.rgbMin, ranges.rgbMax, words);
  const sh = BANDS.slice(0, layout.scene.shDegree).map(([first, count, bits], band) => {
    const target = new Uint32Array(SH_WORDS[band]! * rows);
    packBand(values, rows, width, COLUMNS + first, count, bits, ranges.shRange, SH_WORDS[band]!, target);
    return target;
  });
  const means = Float32Array.from({ length: 3 * rows }, (_, i) => columns[i % 3]![Math.floor(i / 3)]!);
  return { count: rows, words, means, sh, ranges };
}

/** Normalise quaternions w x y z to unit length and w ≥ 0, because training stores unnormalised ones. */
function normalise(
  [w, x, y, z]: readonly [Float32Array, Float32Array, Float32Array, Float32Array],
  rows: number,
): void {
  for (let row = 0; row < rows; row++) {
    const norm = Math.sqrt(w[row]! ** 2 + x[row]! ** 2 + y[row]! ** 2 + z[row]! ** 2);
    const factor = norm > 0 ? (w[row]! < 0 ? -1 : 1) / norm : 0;
    w[row] = norm > 0 ? w[row]! * factor : 1;
    x[row]! *= factor;
    y[row]! *= factor;
    z[row]! *= factor;
  }
}

function concatenateBytes(parts: readonly Uint8Array[]): Uint8Array<ArrayBuffer> {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}
