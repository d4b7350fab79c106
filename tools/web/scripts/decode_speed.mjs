// Decoding speed of one scene in several formats, in Node: node --single-threaded scripts/decode_speed.mjs NAME [rounds]
// reads NAME.cogs, and NAME.spz, NAME.splat and the unpacked NAME.sog in the folder NAME where they are there.
import { Blob, resolveObjectURL } from "node:buffer";
import { existsSync, readFileSync } from "node:fs";
import { loadKernels, SceneFile } from "../dist/cogsplat.js";

/**
 * What Spark takes for a worker: it runs where the page runs, so that Spark decodes on this one thread and hands nothing
 * from thread to thread.
 */
class WorkerOnThisThread {
  listeners = new Set();
  onmessage = null;

  constructor(url) {
    const scope = {
      addEventListener: (_type, listener) => this.listeners.add(listener),
      removeEventListener: (_type, listener) => this.listeners.delete(listener),
      postMessage: (data) => queueMicrotask(() => this.onmessage?.({ data })),
    };
    // Spark revokes the address at once; the Blob behind it stays.
    const program = resolveObjectURL(url);
    this.ready = program.text().then((text) => new Function("self", text)(scope));
  }

  addEventListener() {
    // Spark listens for errors of its program, which end this one.
  }

  async postMessage(data) {
    await this.ready;
    for (const listener of [...this.listeners]) listener({ data });
  }

  terminate() {
    this.listeners.clear();
  }
}

/** Functions that decode all of a file and give its number of splats, by what they do. */
async function contestants(name) {
  const found = [];
  const kernels = await loadKernels();
  const file = new SceneFile(new Uint8Array(readFileSync(`${name}.cogs`)), kernels());
  const chunks = Array.from({ length: file.prefixChunks }, (_, chunk) => chunk);
  const sum = (decode) => async () => chunks.reduce((splats, chunk) => splats + decode(chunk).count, 0);
  found.push(["COGS, level viewer", sum((chunk) => file.decodePacked(chunk))]);
  found.push(["COGS, level reader", sum((chunk) => file.decodeChunk(chunk))]);
  const others = ["spz", "splat"].filter((type) => existsSync(`${name}.${type}`));
  if (others.length > 0) {
    Object.assign(globalThis, { self: globalThis, Worker: WorkerOnThisThread, Blob });
    const { PackedSplats } = await import("@sparkjsdev/spark");
    for (const type of others) {
      const bytes = new Uint8Array(readFileSync(`${name}.${type}`));
      found.push([
        `.${type} by Spark`,
        async () => {
          const splats = new PackedSplats({ fileBytes: bytes, fileType: type });
          await splats.initialized;
          const { numSplats } = splats;
          splats.dispose();
          return numSplats;
        },
      ]);
    }
  }
  if (existsSync(`${name}/meta.json`)) {
    const { default: sharp } = await import("sharp");
    sharp.concurrency(1);
    sharp.cache(false);
    const meta = JSON.parse(readFileSync(`${name}/meta.json`, "utf8"));
    const images = Object.values(meta)
      .flatMap((part) => part?.files ?? [])
      .map((path) => readFileSync(`${name}/${path}`));
    found.push([
      "SOG, its WebP alone, by sharp",
      async () => {
        for (const image of images) await sharp(image).raw().toBuffer();
        return meta.count;
      },
    ]);
  }
  return found;
}

function median(values) {
  return [...values].sort((a, b) => a - b)[values.length >> 1];
}

const [name, rounds = "15"] = process.argv.slice(2);
const all = await contestants(name);
const times = all.map(() => []);
const splats = [];
// The formats take turns, so that other load on the machine affects all equally; the first two rounds compile.
for (let round = -2; round < Number(rounds); round++) {
  for (const [i, [, decode]] of all.entries()) {
    const wall = performance.now();
    const start = process.cpuUsage();
    splats[i] = await decode();
    const { user, system } = process.cpuUsage(start);
    if (round >= 0) times[i].push({ cpu: (user + system) / 1000, wall: performance.now() - wall });
  }
}
console.log("| | ms of CPU time | ms of wall time | million splats/s of CPU time |\n|---|---|---|---|");
for (const [i, [what]] of all.entries()) {
  const [cpu, wall] = [median(times[i].map((time) => time.cpu)), median(times[i].map((time) => time.wall))];
  console.log(`| ${what} | ${cpu.toFixed(1)} | ${wall.toFixed(1)} | ${(splats[i] / cpu / 1000).toFixed(2)} |`);
}
