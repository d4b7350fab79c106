import { CogsplatError } from "../errors.js";
import { Fields, textBytes } from "./fields.js";
import { parseMap } from "./msgpack.js";
import { type Pinhole, readPinhole } from "./pinhole.js";
import {
  type ChunkTable,
  MAX_PAGES,
  MAX_SEGMENTS,
  type PageTable,
  readChunkTable,
  readPageTable,
  readSegmentTable,
  type SegmentTable,
} from "./tables.js";

/** Contents of a codebook's rows (SPEC 5.5). */
export interface CodebookEntry {
  readonly attribute: "shape" | "colour";
  readonly rows: number;
}

/** Types of extra attributes (SPEC 5.7) with the bytes of a value. */
export const ATTRIBUTE_TYPES = { u1: 1, i1: 1, u2: 2, i2: 2, u4: 4, i4: 4, f4: 4, f8: 8 } as const;

/** An extra attribute of splats, which rendering does not use (SPEC 5.7). */
export interface AttributeEntry {
  readonly name: string;
  readonly type: keyof typeof ATTRIBUTE_TYPES;
  /** Values per splat of an array attribute; 0 for a single value. */
  readonly components: number;
}

/** A level of detail (SPEC 5.11). */
export interface LevelEntry {
  /** Number of chunks of the level, from the first of the file on. */
  readonly chunks: number;
  /** Factor by which width and height of its pictures are smaller than at full size. */
  readonly scale: number;
}

/** Contents of the root about the scene (SPEC 4.2). */
export interface SceneInfo {
  readonly writer: string;
  /** Splats of all chunks, including chunks that end. */
  readonly splats: number;
  readonly shDegree: number;
  /** World position of the means' zero, scene units. */
  readonly origin: readonly number[];
  /** Directions of +x, +y and +z, for example `RDF`. */
  readonly axes: string;
  readonly colourSpace: "srgb" | "linear";
  /** Variance that a renderer adds to projected covariances, pixels². */
  readonly kernelPx: number;
  readonly antialiased: boolean;
  /** Bounding box of the splats' extents: minimum corner, then maximum corner. */
  readonly box: readonly number[];
  readonly firstView: Pinhole | undefined;
  /** Unit vector against gravity in the space of the means; undefined for the `U` of the axes. */
  readonly up: readonly number[] | undefined;
  /** Bounding box as `box`, without stray splats such as floaters and sky. */
  readonly coreBox: readonly number[] | undefined;
  /** Viewpoints of the training pictures, by which a renderer keeps the trained thickness of splats; may be empty. */
  readonly capture: readonly Viewpoint[];
  readonly attributes: readonly AttributeEntry[];
  /** Levels, coarsest first; empty for a scene without levels. */
  readonly levels: readonly LevelEntry[];
}

/** Viewpoint of a training picture (SPEC 4.2). */
export interface Viewpoint {
  /** In the space of the means. */
  readonly position: readonly [number, number, number];
  /** Focal length of the full picture, px. */
  readonly focalPx: number;
}

/** The root: scene, codebooks, pages, and the tables of the root itself. */
export interface Root {
  readonly scene: SceneInfo;
  readonly codebooks: readonly CodebookEntry[];
  /** Absent where no page is listed. */
  readonly pages: PageTable | undefined;
  readonly segments: SegmentTable;
  readonly chunks: ChunkTable;
}

/** Viewpoints of the training pictures at most (SPEC 4.2). */
const MAX_VIEWPOINTS = 64;

/** Largest difference between the squared length of a direction and 1 (SPEC 4.2). */
const UNIT_TOLERANCE = 1e-3;

/** Read and check the map of the root, whose CRC was checked. */
export function readRoot(bytes: Uint8Array): Root {
  const fields = new Fields(parseMap(bytes), "root");
  const writer = fields.text("writer");
  if (textBytes(writer) > 255) throw fields.outOfRange("writer", "more than 255 bytes");
  const splats = fields.integer("splats", 0, 2 ** 31 - 1);
  const shDegree = fields.integer("sh_degree", 0, 3);
  const origin = fields.floats("origin", 3);
  const axes = fields.text("axes");
  if (!isAxes(axes)) throw fields.outOfRange("axes", JSON.stringify(axes));
  const colourSpace = fields.text("colour_space");
  if (colourSpace !== "srgb" && colourSpace !== "linear") {
    throw new CogsplatError("colour-space-unknown", `the colour space ${JSON.stringify(colourSpace)}`);
  }
  const kernelPx = fields.float("kernel_px", (value) => value >= 0 && Number.isFinite(value), "finite and at least 0");
  const antialiased = fields.boolean("antialiased");
  const box = readBox(fields, "box");
  const codebooks = fields.maps("codebooks", 32, readCodebook);
  const firstView = fields.has("first_view") ? readPinhole(fields.fields("first_view")) : undefined;
  const up = fields.has("up") ? readUp(fields) : undefined;
  const coreBox = fields.has("core_box") ? readBox(fields, "core_box", box) : undefined;
  const capture = fields.has("capture") ? readCapture(fields) : [];
  const attributes = fields.has("attributes") ? readAttributeEntries(fields) : [];
  const levels = fields.has("levels") ? readLevels(fields) : [];
  const pages = fields.has("pages") ? readPageTable(fields.fields("pages"), MAX_PAGES) : undefined;
  const segments = readSegmentTable(fields.fields("segments"));
  const chunks = readChunkTable(fields.fields("chunks"));
  fields.finish();
  const scene = {
    writer,
    splats,
    shDegree,
    origin,
    axes,
    colourSpace,
    kernelPx,
    antialiased,
    box,
    firstView,
    up,
    coreBox,
    capture,
    attributes,
    levels,
  } as const;
  return { scene, codebooks, pages, segments, chunks };
}

/** Read a bounding box, which lies inside another if one is given. */
function readBox(fields: Fields, key: string, within?: readonly number[]): number[] {
  const box = fields.floats(key, 6);
  if ([0, 1, 2].some((axis) => box[axis]! > box[axis + 3]!))
    throw fields.outOfRange(key, "a minimum above its maximum");
  if (within && [0, 1, 2].some((axis) => box[axis]! < within[axis]! || box[axis + 3]! > within[axis + 3]!)) {
    throw fields.outOfRange(key, "a corner outside the box of the scene");
  }
  return box;
}

/** Read the viewpoints of the training pictures. */
function readCapture(fields: Fields): Viewpoint[] {
  const column = fields.column("capture", 16);
  const count = column.byteLength / 16;
  if (count < 1 || count > MAX_VIEWPOINTS) throw fields.outOfRange("capture", `${count} viewpoints`);
  return Array.from({ length: count }, (_, row) => {
    const [x, y, z, focalPx] = [0, 4, 8, 12].map((at) => column.getFloat32(16 * row + at, true)) as [
      number,
      number,
      number,
      number,
    ];
    if (![x, y, z, focalPx].every(Number.isFinite) || !(focalPx > 0)) {
      throw fields.outOfRange("capture", `the viewpoint ${[x, y, z, focalPx]}`);
    }
    return { position: [x, y, z], focalPx };
  });
}

/** Read the direction against gravity. */
function readUp(fields: Fields): number[] {
  const up = fields.floats("up", 3);
  const square = up[0]! * up[0]! + up[1]! * up[1]! + up[2]! * up[2]!;
  if (!(Math.abs(square - 1) <= UNIT_TOLERANCE)) throw fields.outOfRange("up", `${up} is no unit vector`);
  return up;
}

/** Return whether three letters name one direction of each axis. */
function isAxes(axes: string): boolean {
  const pairs = ["RL", "UD", "FB"];
  return axes.length === 3 && pairs.every((pair) => [...axes].filter((letter) => pair.includes(letter)).length === 1);
}

function readCodebook(fields: Fields): CodebookEntry {
  const attribute = fields.text("attribute");
  if (attribute !== "shape" && attribute !== "colour") {
    throw new CogsplatError("codebook-unknown", `${fields.where} is of ${JSON.stringify(attribute)}`);
  }
  const rows = fields.integer("rows", 1, 65_536);
  fields.finish();
  return { attribute, rows };
}

function readAttributeEntries(root: Fields): AttributeEntry[] {
  const names = new Set<string>();
  return root.maps("attributes", 256, (fields) => {
    const name = fields.text("name");
    const bytes = textBytes(name);
    if (bytes < 1 || bytes > 255) throw fields.outOfRange("name", `${bytes} bytes`);
    if (names.has(name)) throw fields.outOfRange("name", `${JSON.stringify(name)} twice`);
    names.add(name);
    const type = fields.text("type");
    if (!Object.hasOwn(ATTRIBUTE_TYPES, type)) {
      throw new CogsplatError("attribute-type-unknown", `${fields.where} is of type ${JSON.stringify(type)}`);
    }
    const components = fields.has("components") ? fields.integer("components", 1, 16) : 0;
    fields.finish();
    return { name, type: type as keyof typeof ATTRIBUTE_TYPES, components };
  });
}

function readLevels(root: Fields): LevelEntry[] {
  let before: LevelEntry = { chunks: 0, scale: Infinity };
  const levels = root.maps("levels", 16, (fields) => {
    before = {
      chunks: fields.integer("chunks", before.chunks + 1, MAX_SEGMENTS),
      scale: fields.float("scale", (value) => value > 0 && value < before.scale, "above 0 and falling"),
    };
    fields.finish();
    return before;
  });
  if (levels.length === 0) throw root.outOfRange("levels", "none");
  return levels;
}
