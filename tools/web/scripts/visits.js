// Page of tools/lab/benchmark/visit_validation.py: records the decoded chunks of a scene at given times along a camera path.
import { DecoderPool, StreamedScene } from "./cogsplat.js";
import { Visit } from "./visit.js";

/**
 * Visit a scene, and note which chunks are there at each moment.
 *
 * @param poses - Where the visitor is, one pose every `interval` seconds from the first request on.
 * @param budget - Most splats in memory; 0 for any number.
 * @param moments - Seconds, ascending.
 * @returns When the first request was made, the first worker had started and the first rows had come; for each moment when it was noted, and the chunks, each with whether it is refined and whether it has its coefficients above DC; and the memory of the page and its workers at the last moment, bytes.
 */
window.visit = async ({ url, poses, interval, budget, moments }) => {
  performance.clearResourceTimings();
  const begin = performance.now();
  const seconds = () => (performance.now() - begin) / 1000;
  let decoding;
  const makeWorker = () => {
    const worker = new Worker("worker.js", { type: "module" });
    worker.addEventListener("message", () => (decoding ??= seconds()), { once: true });
    return worker;
  };
  const scene = await StreamedScene.open(url, { service: (index) => new DecoderPool(index, { makeWorker }) });
  const abort = new AbortController();
  const options = { format: "packed", compensate: true, signal: abort.signal };
  const visit = await Visit.begin(scene, budget > 0 ? { ...options, splatBudget: budget } : options);
  const look = () => visit.setPose(poses[Math.min(Math.floor(seconds() / interval), poses.length - 1)]);
  look();
  const timer = setInterval(look, 1000 * interval);
  const held = new Map();
  let rows;
  const gone = (async () => {
    for await (const change of visit.changes()) {
      if (change.kind === "evicted") held.delete(change.chunk);
      else held.set(change.chunk, change);
      rows ??= seconds();
    }
  })().catch((error) => {
    if (!abort.signal.aborted) throw error;
  });
  const noted = [];
  for (const moment of moments) {
    await new Promise((resolve) => setTimeout(resolve, 1000 * (moment - seconds())));
    const chunks = [...held.values()].map(({ chunk, refined, tail }) => [chunk, refined, tail]);
    noted.push({ seconds: seconds(), chunks });
  }
  const memory = await measured();
  clearInterval(timer);
  abort.abort();
  await gone;
  const [first] = performance.getEntriesByName(new URL(url, location.href).href);
  return { started: (first.startTime - begin) / 1000, decoding, rows, noted, memory };
};

/** Return the memory of the page and of its workers, bytes; undefined where the browser does not tell. */
async function measured() {
  if (!self.crossOriginIsolated) return undefined;
  const { breakdown } = await performance.measureUserAgentSpecificMemory();
  const sum = (isWorker) =>
    breakdown
      .filter(({ attribution }) => attribution.some(({ scope }) => scope.includes("Worker")) === isWorker)
      .reduce((bytes, part) => bytes + part.bytes, 0);
  return [sum(false), sum(true)];
}
