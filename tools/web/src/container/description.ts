import { CogsplatError } from "../errors.js";
import { Fields, textBytes } from "./fields.js";
import { parseMap } from "./msgpack.js";
import { isJpegOrWebp, readPictureHeader } from "./picture_header.js";
import { isRotation, type Pinhole, readPinhole } from "./pinhole.js";

/** Values of a description's map at most (SPEC 4.1). */
const MAX_VALUES = 131_072;
const MAX_VIEWS = 256;
const MAX_ANNOTATIONS = 256;
const MAX_STOPS = 1_024;
/** Longest side of a picture, px (SPEC 9.1). */
const MAX_SIDE = 8_192;

/** Units in which viewers show lengths. */
const UNITS = ["mm", "cm", "m", "km", "in", "ft"] as const;

/** Unit in which viewers show lengths. */
export type LengthUnit = (typeof UNITS)[number];

/** Names of the pictures, by the owner of their segments (SPEC 5.14). */
export const PICTURE_NAMES = ["poster", "sky"] as const;

/** Name of a picture of the description. */
export type PictureName = (typeof PICTURE_NAMES)[number];

/** A view with a name. */
export interface NamedView extends Pinhole {
  readonly name: string;
}

/** A view that a camera path reaches at a time. */
export interface PathStop extends Pinhole {
  /** Time since the start of the path, seconds. */
  readonly time: number;
}

/** A camera path: 2 to 1,024 stops at ascending times, the first at 0. */
export interface CameraPath {
  /** Whether the path starts again at its end. */
  readonly loop: boolean;
  readonly stops: readonly PathStop[];
}

/** A text at a place of the scene. */
export interface Annotation {
  /** Position in the space of the means. */
  readonly place: readonly number[];
  readonly title: string;
  readonly text: string;
  /** View from which to look at the place. */
  readonly view: Pinhole | undefined;
}

/** Position of the scene on Earth. */
export interface Georeference {
  /** Coordinate reference system, such as `EPSG:4978` or WKT 2. */
  readonly crs: string;
  /** Matrix from world coordinates (origin + means) to coordinates of the system, 16 numbers, row by row. */
  readonly transform: readonly number[];
}

/** Type and size of a picture. */
export interface PictureInfo {
  readonly type: "image/jpeg" | "image/webp";
  /** Pixels. */
  readonly width: number;
  /** Pixels. */
  readonly height: number;
  /** Rotation of a sky, row by row: from the space of the means to the picture's x right, y down, z middle. */
  readonly rotation: readonly number[] | undefined;
}

/**
 * Description of a scene (SPEC 5.13). Texts are data, never markup: show them with `textContent`.
 */
export interface Description {
  readonly title: string | undefined;
  readonly text: string | undefined;
  readonly licence: string | undefined;
  readonly credits: string | undefined;
  /** Date of ISO 8601, from `2026` to a time with its offset. */
  readonly date: string | undefined;
  readonly metresPerUnit: number | undefined;
  readonly unit: LengthUnit | undefined;
  /** sRGB colour behind the splats, each 0 to 1. */
  readonly background: readonly number[] | undefined;
  readonly views: readonly NamedView[];
  readonly path: CameraPath | undefined;
  readonly annotations: readonly Annotation[];
  readonly georeference: Georeference | undefined;
  readonly poster: PictureInfo | undefined;
  readonly sky: PictureInfo | undefined;
}

// Control characters other than tab and line feed.
// biome-ignore lint/suspicious/noControlCharactersInRegex: these are the characters that SPEC refuses.
const CONTROLS = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f]/;
const DATE =
  /^\d{4}(-(0[1-9]|1[0-2])(-(0[1-9]|[12]\d|3[01])(T([01]\d|2[0-3]):[0-5]\d(:[0-5]\d(\.\d{1,9})?)?(Z|[+-]([01]\d|2[0-3]):[0-5]\d)?)?)?)?$/;

/** Read the segment of the description, whose CRC was checked (SPEC 5.13). */
export function readDescription(payload: Uint8Array): Description {
  const fields = new Fields(parseMap(payload, MAX_VALUES), "description");
  const optional = <T>(key: string, read: () => T): T | undefined => (fields.has(key) ? read() : undefined);
  const description: Description = {
    title: optional("title", () => readText(fields, "title", 255)),
    text: optional("text", () => readText(fields, "text", 16_384)),
    licence: optional("licence", () => readText(fields, "licence", 255)),
    credits: optional("credits", () => readText(fields, "credits", 1_024)),
    date: optional("date", () => readDate(fields)),
    metresPerUnit: optional("metres_per_unit", () =>
      fields.float("metres_per_unit", (value) => value > 0 && Number.isFinite(value), "above 0 and finite"),
    ),
    unit: optional("unit", () => readUnit(fields)),
    background: optional("background", () => readColour(fields)),
    views: optional("views", () => fields.maps("views", MAX_VIEWS, readView)) ?? [],
    path: optional("path", () => readPath(fields.fields("path"))),
    annotations: optional("annotations", () => fields.maps("annotations", MAX_ANNOTATIONS, readAnnotation)) ?? [],
    georeference: optional("georeference", () => readGeoreference(fields.fields("georeference"))),
    poster: optional("poster", () => readPicture(fields.fields("poster"), false)),
    sky: optional("sky", () => readPicture(fields.fields("sky"), true)),
  };
  fields.finish();
  return description;
}

/**
 * Refuse a picture whose header does not say what the description says (SPEC 5.14), before a decoder sees it.
 *
 * @param payload - Bytes of the picture's segment.
 */
export function checkPicture(stated: PictureInfo, payload: Uint8Array): void {
  const { type, width, height } = readPictureHeader(payload);
  if (type === stated.type && width === stated.width && height === stated.height) return;
  throw new CogsplatError(
    "picture-header",
    `${type} of ${width}×${height} px, the description says ${stated.type} of ${stated.width}×${stated.height}`,
  );
}

function readText(fields: Fields, key: string, most: number, least = 0): string {
  const text = fields.text(key);
  const bytes = textBytes(text);
  if (bytes < least || bytes > most) throw fields.outOfRange(key, `${bytes} bytes, expected ${least} to ${most}`);
  if (CONTROLS.test(text)) throw fields.outOfRange(key, "a control character");
  return text;
}

function readDate(fields: Fields): string {
  const date = readText(fields, "date", 32);
  if (!DATE.test(date)) throw fields.outOfRange("date", `no date: ${date}`);
  return date;
}

function readUnit(fields: Fields): LengthUnit {
  const text = fields.text("unit");
  const unit = UNITS.find((known) => known === text);
  if (unit === undefined) throw fields.outOfRange("unit", `expected one of ${UNITS.join(", ")}`);
  return unit;
}

function readColour(fields: Fields): readonly number[] {
  const colour = fields.floats("background", 3);
  if (!colour.every((part) => part >= 0 && part <= 1)) throw fields.outOfRange("background", `${colour}`);
  return colour;
}

function readView(fields: Fields): NamedView {
  const name = readText(fields, "name", 255);
  return { name, ...readPinhole(fields) };
}

function readPath(fields: Fields): CameraPath {
  const loop = fields.boolean("loop");
  let before = -1;
  const stops = fields.maps("stops", MAX_STOPS, (stop): PathStop => {
    const time = stop.float("time", Number.isFinite, "finite");
    if (before < 0 ? time !== 0 : time <= before) throw stop.outOfRange("time", `${time} after ${before}`);
    before = time;
    return { time, ...readPinhole(stop) };
  });
  if (stops.length < 2) throw fields.outOfRange("stops", `${stops.length} stops`);
  fields.finish();
  return { loop, stops };
}

function readAnnotation(fields: Fields): Annotation {
  const place = fields.floats("place", 3);
  const title = readText(fields, "title", 255);
  const text = readText(fields, "text", 4_096);
  const view = fields.has("view") ? readPinhole(fields.fields("view")) : undefined;
  fields.finish();
  return { place, title, text, view };
}

function readGeoreference(fields: Fields): Georeference {
  const crs = readText(fields, "crs", 4_096, 1);
  const transform = fields.floats("transform", 16);
  const [a, b, c, , d, e, f, , g, h, i] = transform;
  const determinant = a! * (e! * i! - f! * h!) - b! * (d! * i! - f! * g!) + c! * (d! * h! - e! * g!);
  if (transform.slice(12).some((value, column) => value !== (column === 3 ? 1 : 0))) {
    throw fields.outOfRange("transform", "a last row other than 0, 0, 0, 1");
  }
  if (!Number.isFinite(determinant) || determinant === 0) {
    throw fields.outOfRange("transform", `determinant ${determinant}`);
  }
  fields.finish();
  return { crs, transform };
}

/** Read type, size and rotation of a picture, and refuse a sky of another shape than 2:1. */
function readPicture(fields: Fields, isSky: boolean): PictureInfo {
  const type = fields.text("type");
  if (!isJpegOrWebp(type)) throw fields.outOfRange("type", "neither image/jpeg nor image/webp");
  const width = fields.integer("width", 1, MAX_SIDE);
  const height = fields.integer("height", 1, MAX_SIDE);
  if (isSky && width !== 2 * height) throw fields.outOfRange("width", `${width}, expected ${2 * height}`);
  const rotation = isSky && fields.has("rotation") ? readRotation(fields) : undefined;
  fields.finish();
  return { type, width, height, rotation };
}

function readRotation(fields: Fields): readonly number[] {
  const rotation = fields.floats("rotation", 9);
  if (!isRotation(rotation)) throw fields.outOfRange("rotation", "no rotation matrix");
  return rotation;
}
