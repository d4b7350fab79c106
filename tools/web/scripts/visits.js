// Page of tools/lab/benchmark/visit_validation.py: records the decoded chunks of a scene at given times along a camera path.
import { DecoderPool, StreamedScene } from "./cogsplat.js";
import { Visit } from "./visit.js";

/**
 * Visit a scene, and note which chunks are there at each moment.
 *
 * @param poses - Where the visitor is, one pose every `interval` seconds from the first request on.
 * @param budget - Most splats in memory; 0 for any number.
 * @param moments - Seconds, ascending.
 * @returns When the first request was made and the first worker had started, and for each moment when it was noted, and the chunks, each with whether it is refined and whether it has its coefficients above DC.
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
  const gone = (async () => {
    for await (const change of visit.changes()) {
      if (change.kind === "evicted") held.delete(change.chunk);
      else held.set(change.chunk, [change.chunk, change.refined, change.tail]);
    }
  })().catch((error) => {
    if (!abort.signal.aborted) throw error;
  });
  const noted = [];
  for (const moment of moments) {
    await new Promise((resolve) => setTimeout(resolve, 1000 * (moment - seconds())));
    noted.push({ seconds: seconds(), chunks: [...held.values()] });
  }
  clearInterval(timer);
  abort.abort();
  await gone;
  const [first] = performance.getEntriesByName(new URL(url, location.href).href);
  return { started: (first.startTime - begin) / 1000, decoding, noted };
};
