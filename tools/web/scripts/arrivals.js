// What a browser has decoded of a scene at each moment while its file comes: COGS by this package, other formats by
// Spark's decoders. The page of tools/lab/benchmark/time_to_picture.py; everything is kept as packed splats.
import { DecoderPool, SH_WORDS, StreamedScene, shiftPacked } from "./cogsplat.js";

/** Shortest time between two copies of the splats, ms. */
const COPY_INTERVAL = 30;

/** Stream a COGS file; gives a copy of its splats whenever chunks have come. */
async function streamCogs(url, since) {
  const copies = [];
  const scene = await StreamedScene.open(url, { service: (index) => new DecoderPool(index) });
  const { splats, shDegree } = scene.info;
  const words = new Uint32Array(4 * splats);
  const sh = SH_WORDS.slice(0, shDegree).map((count) => new Uint32Array(count * splats));
  const given = new Map();
  const shifted = new Set();
  let encoding;
  const copy = () => {
    copies.push({
      seconds: since(),
      words: words.slice(),
      sh: sh.map((band) => band.slice()),
      encoding,
      count: splats,
    });
  };
  let copied = -Infinity;
  let changed = false;
  for await (const update of scene.stream({ format: "packed", compensate: true })) {
    given.set(update.chunk, update);
    for (const { chunk, packed, firstRow } of given.values()) {
      const shifts = chunk < update.prefix ? scene.compensation.shifts(update.prefix, chunk) : undefined;
      if (chunk !== update.chunk && shifts === undefined && !shifted.has(chunk)) continue;
      if (shifts === undefined) words.set(packed.words, 4 * firstRow);
      else shiftPacked(packed.words, shifts, words, 4 * firstRow);
      packed.sh.forEach((band, i) => {
        sh[i].set(band, SH_WORDS[i] * firstRow);
      });
      if (shifts === undefined) shifted.delete(chunk);
      else shifted.add(chunk);
    }
    const { rgbMin, rgbMax, shRange } = update.packed.ranges;
    encoding = { rgbMin, rgbMax, shMax: [shRange, shRange, shRange] };
    changed = true;
    if (since() - copied < COPY_INTERVAL / 1000) continue;
    copy();
    [copied, changed] = [since(), false];
  }
  if (changed) copy();
  return copies;
}

/** Load a file with Spark, which shows it when all of it has been decoded. */
async function loadWithSpark(url, since) {
  const { PackedSplats } = await import("./spark.module.min.js");
  const splats = await new PackedSplats({ url }).initialized;
  const seconds = since();
  const { packedArray, numSplats: count, extra, splatEncoding: given = {} } = splats;
  const sh = [extra.sh1, extra.sh2, extra.sh3].filter((band) => band !== undefined);
  const shMax = [given.sh1Max ?? 1, given.sh2Max ?? 1, given.sh3Max ?? 1];
  const encoding = { rgbMin: given.rgbMin ?? 0, rgbMax: given.rgbMax ?? 1, shMax };
  const words = packedArray.slice(0, 4 * count);
  return [{ seconds, words, sh: sh.map((band, i) => band.slice(0, SH_WORDS[i] * count)), encoding, count }];
}

/** Note how many bytes of a file have come, for a format that can be drawn row by row. */
async function noteBytes(url, since) {
  const reader = (await fetch(url)).body.getReader();
  const copies = [];
  let bytes = 0;
  for (let part = await reader.read(); !part.done; part = await reader.read()) {
    bytes += part.value.length;
    copies.push({ seconds: since(), bytes });
  }
  return copies;
}

const WAYS = { cogs: streamCogs, spark: loadWithSpark, bytes: noteBytes };

/** An array as base64, by which it leaves the page. */
function base64(array) {
  return new Promise((resolve) => {
    const reader = new FileReader();
    reader.onload = () => resolve(reader.result.slice(reader.result.indexOf(",") + 1));
    reader.readAsDataURL(new Blob([array]));
  });
}

let copies = [];

/** Load a file one of the ways; gives the seconds of every copy, the arrays stay here for `arrays`. */
window.arrive = async (way, url) => {
  const begin = performance.now();
  copies = await WAYS[way](url, () => (performance.now() - begin) / 1000);
  return copies.map(({ seconds }) => ({ seconds }));
};

/** The packed splats of one copy. */
window.arrays = async (number) => {
  const { words, sh, encoding, count } = copies[number];
  return { words: await base64(words), sh: await Promise.all(sh.map(base64)), encoding, count };
};

/** The bytes that had come at one copy. */
window.bytes = (number) => copies[number].bytes;
