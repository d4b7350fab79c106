// Decoding speed of one file: node scripts/bench.mjs SCENE.cogs [seconds]
import { readFileSync } from "node:fs";
import { loadKernels } from "../build/src/kernels/load.js";
import { SceneFile } from "../build/src/scene/scene_file.js";

const [path, seconds = "3"] = process.argv.slice(2);
const bytes = new Uint8Array(readFileSync(path));
const wasm = await loadKernels();

function measure(name, decodeAll) {
  let splats = 0;
  let best = Infinity;
  const until = process.cpuUsage().user + Number(seconds) * 1e6;
  do {
    const start = process.cpuUsage();
    splats = decodeAll();
    const { user, system } = process.cpuUsage(start);
    best = Math.min(best, (user + system) / 1e6);
  } while (process.cpuUsage().user < until);
  console.log(
    `${name}: ${splats} splats in ${(best * 1e3).toFixed(1)} ms of CPU time, ${(splats / best / 1e6).toFixed(2)} M/s`,
  );
}

function reader(file) {
  return () => {
    let splats = 0;
    for (let chunk = 0; chunk < file.prefixChunks; chunk++)
      splats += file.decodeChunk(chunk, undefined, !process.env.COARSE).count;
    return splats;
  };
}

function viewer(file) {
  return () => {
    let splats = 0;
    for (let chunk = 0; chunk < file.prefixChunks; chunk++) splats += file.decodePacked(chunk).count;
    return splats;
  };
}

console.log(`${path}: ${bytes.length} bytes`);
measure("reader, wasm", reader(new SceneFile(bytes, wasm())));
measure("viewer, wasm", viewer(new SceneFile(bytes, wasm())));
