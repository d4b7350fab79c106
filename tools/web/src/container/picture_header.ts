import { CogsplatError } from "../errors.js";

/** Largest number of chunks before the picture data of a WebP (SPEC 5.14). */
const MAX_CHUNKS = 16;

/** Type and size in the header of a picture. */
export interface PictureHeader {
  readonly type: "image/jpeg" | "image/webp";
  /** Pixels. */
  readonly width: number;
  /** Pixels. */
  readonly height: number;
}

/** Return whether a media type is one of SPEC 5.14. */
export function isJpegOrWebp(type: string): type is PictureHeader["type"] {
  return type === "image/jpeg" || type === "image/webp";
}

/**
 * Read the header of a JPEG or a still WebP (SPEC 5.14); nothing is decoded.
 *
 * @throws CogsplatError `picture-header` for another format, and for a picture that is cut.
 */
export function readPictureHeader(bytes: Uint8Array): PictureHeader {
  const reader = new HeaderReader(bytes);
  if (reader.u16(0) === 0xffd8) return { type: "image/jpeg", ...jpegSize(reader) };
  if (reader.text(0) === "RIFF" && reader.text(8) === "WEBP") return { type: "image/webp", ...webpSize(reader) };
  throw refusal("neither a JPEG nor a WebP");
}

type Size = Pick<PictureHeader, "width" | "height">;

function refusal(found: string): CogsplatError {
  return new CogsplatError("picture-header", `a picture: ${found}`);
}

/** Reads numbers of a header; a read behind the end is refused. */
class HeaderReader {
  private readonly view: DataView;

  constructor(bytes: Uint8Array) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  get length(): number {
    return this.view.byteLength;
  }

  u8(at: number): number {
    return this.view.getUint8(this.within(at, 1));
  }

  /** Read a big-endian number, or with `little` a little-endian one. */
  u16(at: number, little = false): number {
    return this.view.getUint16(this.within(at, 2), little);
  }

  /** Read a little-endian number. */
  u24(at: number): number {
    return this.u8(at) | (this.u16(at + 1, true) << 8);
  }

  /** Read a little-endian number. */
  u32(at: number): number {
    return this.view.getUint32(this.within(at, 4), true);
  }

  /** Read four characters. */
  text(at: number): string {
    return String.fromCharCode(this.u8(at), this.u8(at + 1), this.u8(at + 2), this.u8(at + 3));
  }

  private within(at: number, count: number): number {
    if (at < 0 || at + count > this.length) throw refusal(`${this.length} bytes end inside its header`);
    return at;
  }
}

/** Read the size of a JPEG from its first frame header (ITU T.81, B.2.2). */
function jpegSize(reader: HeaderReader): Size {
  if (reader.u16(reader.length - 2) !== 0xffd9) throw refusal("no marker of a JPEG's end at its end");
  for (let at = 2; ; ) {
    const marker = reader.u8(at + 1);
    const length = reader.u16(at + 2);
    if (reader.u8(at) !== 0xff || length < 2) throw refusal(`no marker segment at byte ${at}`);
    // C4, C8 and CC are tables, extensions and arithmetic conditioning; the others of C0 to CF start a frame.
    if (marker >= 0xc0 && marker <= 0xcf && marker !== 0xc4 && marker !== 0xc8 && marker !== 0xcc) {
      const components = reader.u8(at + 9);
      if (marker > 0xc2 || reader.u8(at + 4) !== 8 || (components !== 1 && components !== 3)) {
        throw refusal(`a frame of marker ${marker} and ${components} components`);
      }
      return { width: reader.u16(at + 7), height: reader.u16(at + 5) };
    }
    at += 2 + length;
  }
}

/** Read the size of a still WebP from its chunks (RFC 9649, 2.3 to 2.7). */
function webpSize(reader: HeaderReader): Size {
  if (reader.u32(4) + 8 !== reader.length)
    throw refusal(`${reader.length} bytes, its header says ${reader.u32(4) + 8}`);
  let at = 12;
  let canvas: Size | undefined;
  for (let chunk = 0; chunk < MAX_CHUNKS; chunk++) {
    const kind = reader.text(at);
    const length = reader.u32(at + 4);
    const data = at + 8;
    if (data + length > reader.length) throw refusal(`it ends inside the chunk at byte ${at}`);
    if (kind === "VP8 " || kind === "VP8L") {
      const size = frameSize(reader, kind, data, length);
      if (canvas && (canvas.width !== size.width || canvas.height !== size.height)) {
        throw refusal(`${size.width}×${size.height} px on a canvas of ${canvas.width}×${canvas.height}`);
      }
      return size;
    }
    if (kind === "ANIM" || kind === "ANMF") break;
    if (kind === "VP8X") {
      if (length < 10) throw refusal("a short chunk VP8X");
      if ((reader.u8(data) & 2) !== 0) break;
      canvas = { width: reader.u24(data + 4) + 1, height: reader.u24(data + 7) + 1 };
    }
    at = data + length + (length & 1);
  }
  throw refusal("no still picture in its first chunks");
}

/** Read the size in the frame header of a lossy or lossless WebP (RFC 9649, 2.5 and 2.6). */
function frameSize(reader: HeaderReader, kind: string, data: number, length: number): Size {
  if (kind === "VP8 " && length >= 10 && reader.u24(data + 3) === 0x2a019d) {
    return { width: reader.u16(data + 6, true) & 0x3fff, height: reader.u16(data + 8, true) & 0x3fff };
  }
  if (kind === "VP8L" && length >= 5 && reader.u8(data) === 0x2f) {
    const bits = reader.u32(data + 1);
    return { width: (bits & 0x3fff) + 1, height: ((bits >>> 14) & 0x3fff) + 1 };
  }
  throw refusal("no frame header");
}
