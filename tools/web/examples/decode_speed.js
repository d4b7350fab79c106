// Decoding speed of one scene in several formats: decode_speed.html?scene=NAME&rounds=7 reads NAME.cogs, NAME.spz and
// NAME.splat beside this page, those that are there, and the pictures of NAME.sog in the folder NAME.
import { PackedSplats } from "@sparkjsdev/spark";
import { loadKernels, SceneFile } from "cogsplat";

const parameters = new URLSearchParams(location.search);
const name = parameters.get("scene") ?? "scene";
const rounds = Number(parameters.get("rounds") ?? 7);
const table = document.querySelector("tbody");

async function bytesOf(path) {
  const response = await fetch(path);
  return response.ok ? new Uint8Array(await response.arrayBuffer()) : undefined;
}

/** Decoders to measure: a name, and a function that decodes a file and returns its number of splats. */
async function contestants() {
  const found = [];
  const cogs = await bytesOf(`${name}.cogs`);
  const kernels = await loadKernels();
  const file = new SceneFile(cogs, kernels());
  const chunks = Array.from({ length: file.prefixChunks }, (_, chunk) => chunk);
  const sum = (decode) => async () => chunks.reduce((splats, chunk) => splats + decode(chunk).count, 0);
  found.push(["COGS, level reader", sum((chunk) => file.decodeChunk(chunk))]);
  found.push(["COGS, level viewer", sum((chunk) => file.decodePacked(chunk))]);
  for (const type of ["spz", "splat"]) {
    const bytes = await bytesOf(`${name}.${type}`);
    if (bytes === undefined) continue;
    found.push([
      `${type} by Spark`,
      async () => {
        // A copy, because Spark hands the bytes to its worker.
        const splats = new PackedSplats({ fileBytes: bytes.slice(), fileType: type });
        await splats.initialized;
        const { numSplats } = splats;
        splats.dispose();
        return numSplats;
      },
    ]);
  }
  const meta = await fetch(`${name}/meta.json`).then((response) => (response.ok ? response.json() : undefined));
  if (meta !== undefined) {
    const names = Object.values(meta).flatMap((part) => part?.files ?? []);
    const images = await Promise.all(names.map((image) => bytesOf(`${name}/${image}`)));
    found.push([
      "SOG, its WebP alone, by the browser",
      async () => {
        for (const image of images) {
          const bitmap = await createImageBitmap(new Blob([image]), {
            premultiplyAlpha: "none",
            colorSpaceConversion: "none",
          });
          const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
          context.drawImage(bitmap, 0, 0);
          context.getImageData(0, 0, bitmap.width, bitmap.height);
          bitmap.close();
        }
        return meta.count ?? meta.means.shape[0];
      },
    ]);
  }
  return found;
}

const all = await contestants();
const times = all.map(() => []);
const splats = [];
for (let round = 0; round <= rounds; round++) {
  for (const [i, [, decode]] of all.entries()) {
    const start = performance.now();
    splats[i] = await decode();
    // The first round compiles and starts workers.
    if (round > 0) times[i].push(performance.now() - start);
  }
}
const results = all.map(([what], i) => {
  const median = times[i].sort((a, b) => a - b)[times[i].length >> 1];
  return { what, splats: splats[i], ms: median, millionsPerSecond: splats[i] / median / 1000 };
});
for (const { what, ms, millionsPerSecond } of results) {
  const row = table.insertRow();
  for (const text of [what, millionsPerSecond.toFixed(2), `${ms.toFixed(1)} ms`]) row.insertCell().textContent = text;
}
globalThis.results = results;
