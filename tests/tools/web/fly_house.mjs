// Fly through a house in virtual time, under a budget of splats: `node --expose-gc fly_house.mjs DIST SCENE POSES JSON`.
//
// POSES has one pose per tenth of a second; the camera repeats the path forwards and backwards. The output is JSON: splats
// held, chunks fetched again after an eviction, and the memory at intervals of `heapSeconds`; with `record` also the units
// and ratios of the scheduler, and its decisions.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [dist, scenePath, posesPath, options] = process.argv.slice(2);
const { budget, seconds, bytesPerSecond, latency, heapSeconds, record: isRecorded } = JSON.parse(options);
/** Milliseconds of virtual time from one event to the next. */
const STEP = 25;

let now = 0;
let timers = [];
performance.now = () => now;
globalThis.setTimeout = (call, wait = 0) => {
  const timer = { call, at: now + Math.max(wait, 1) };
  timers.push(timer);
  return timer;
};
globalThis.clearTimeout = (timer) => {
  timers = timers.filter((other) => other !== timer);
};

/** A server behind a link whose rate all answers share. */
class Link {
  requests = new Set();
  sent = 0;

  constructor(bytes) {
    this.bytes = bytes;
  }

  async read({ offset, length }, { signal } = {}) {
    const request = { position: offset, end: Math.min(offset + length, this.bytes.length), from: now + 1000 * latency };
    this.requests.add(request);
    const { bytes, requests } = this;
    signal?.addEventListener("abort", () => request.wake?.());
    const parts = (async function* () {
      try {
        for (let at = offset; at < request.end; ) {
          signal?.throwIfAborted();
          if (request.position === at) await new Promise((wake) => (request.wake = wake));
          signal?.throwIfAborted();
          yield bytes.slice(at, request.position);
          at = request.position;
        }
      } finally {
        requests.delete(request);
      }
    })();
    return { offset, total: bytes.length, whole: false, parts };
  }

  step(milliseconds) {
    let left = Math.round((bytesPerSecond * milliseconds) / 1000);
    for (const request of this.requests) {
      if (request.from > now) continue;
      const count = Math.min(left, request.end - request.position);
      request.position += count;
      this.sent += count;
      left -= count;
      if (count > 0) request.wake?.();
    }
  }
}

async function settle() {
  for (let turn = 0; turn < 6; turn++) await new Promise((resolve) => setImmediate(resolve));
}

const load = (name) => import(pathToFileURL(`${dist}/${name}`).href);
const { StreamedScene } = await load("cogsplat.js");
const { Scheduler, Visit } = await load("visit.js");

const found = { decisions: 0, most: 0, mostDrawn: 0, evictions: 0, refetched: 0, soonAgain: 0, unneeded: 0, heapMb: [] };
const evicted = new Map();

const known = new WeakMap();

/** Return the unit that is the head of each chunk or unread page, looked up once for each scheduler. */
function headsOf(scheduler) {
  if (!known.has(scheduler)) {
    known.set(scheduler, new Map(scheduler.units.flatMap(({ row, isHead }, unit) => (isHead ? [[row, unit]] : []))));
  }
  return known.get(scheduler);
}

/** Return the worth of each chunk that is not held: the largest of itself and its descendants (docs/streaming.md, 9). */
function worthsOf({ units, splats, contribution }, heads, ratios) {
  const worths = new Map([...heads.keys()].map((chunk) => [chunk, (ratios[chunk] * contribution[chunk]) / splats[chunk]]));
  for (const chunk of [...heads.keys()].sort((a, b) => b - a)) {
    const parent = units[heads.get(chunk)].dependencies.map((unit) => units[unit].row).find((other) => other >= 0);
    if (parent !== undefined) worths.set(parent, Math.max(worths.get(parent), worths.get(chunk)));
  }
  return worths;
}

const { decide } = Scheduler.prototype;
Scheduler.prototype.decide = function (ratios, holdings) {
  const decision = decide.call(this, ratios, holdings);
  const held = new Set();
  const heads = headsOf(this);
  const record = () => {
    const splats = [...held].reduce((sum, chunk) => sum + this.splats[chunk], 0);
    found.most = Math.max(found.most, splats);
  };
  for (const [chunk, head] of heads) {
    if (holdings.arrived.has(head) || holdings.inFlight.has(head)) held.add(chunk);
  }
  record();
  for (const [chunk, worth] of decision.evict) {
    held.delete(chunk);
    evicted.set(chunk, { at: now, worth });
    found.evictions++;
  }
  for (const unit of decision.stop) if (this.units[unit].isHead) held.delete(this.units[unit].row);
  for (const unit of decision.fetch) {
    const { row: chunk, isHead } = this.units[unit];
    if (!isHead) continue;
    held.add(chunk);
    const before = evicted.get(chunk);
    if (before === undefined) continue;
    evicted.delete(chunk);
    found.refetched++;
    if (now - before.at >= 1000) continue;
    found.soonAgain++;
    // Rounding of the urgency may differ in the last bit.
    if (worthsOf(this, heads, ratios).get(chunk) < (1 - 1e-12) * before.worth) found.unneeded++;
  }
  record();
  found.decisions++;
  if (isRecorded) recordDecision(this, ratios, holdings, decision);
  return decision;
};

const recorded = [];
let [lastScheduler, lastRatios, visit] = [];

/** Record a decision; segments and pages by their places in the file, rows by their chunks or pages. */
function recordDecision(scheduler, ratios, holdings, decision) {
  const { index, source } = visit;
  const start = ({ segment }) => (segment < 0 ? index.pages[-1 - segment].offset : source.places.range(segment).offset);
  const { chunks, pages } = index.rows;
  const row = (at) => (at < 0 ? null : [pages[at]?.offset ?? -1, chunks[at]]);
  const starts = scheduler.units.map(start);
  const entry = {
    arrived: [...holdings.arrived].map((unit) => starts[unit]),
    inFlight: [...holdings.inFlight].map((unit) => starts[unit]),
    received: [...holdings.received].map(([unit, bytes]) => [starts[unit], bytes]),
    evictedWorths: [...holdings.evictedWorths].map(([at, worth]) => [row(at), worth]),
    bytesPerSecond: holdings.bytesPerSecond,
    latency: holdings.latency,
    stop: decision.stop.map((unit) => starts[unit]),
    evict: [...decision.evict.keys()].map(row),
    fetch: decision.fetch.map((unit) => starts[unit]),
  };
  if (scheduler !== lastScheduler) {
    entry.units = scheduler.units.map((unit) => ({
      ...{ start: start(unit), gain: unit.gain, size: unit.size, row: row(unit.row), isHead: unit.isHead },
      dependencies: unit.dependencies.map((other) => starts[other]),
    }));
    entry.splats = scheduler.splats.map((splats, at) => [row(at), splats]);
  }
  if (ratios !== lastRatios) {
    entry.ratios = [...ratios].map((ratio, at) => [row(at), ratio]);
    // A table is used when it is read, a moment after it has arrived.
    entry.tables = [...visit.poseRatios.tables.keys()].map((of) => of.start);
  }
  [lastScheduler, lastRatios] = [scheduler, ratios];
  recorded.push(entry);
}

const link = new Link(new Uint8Array(readFileSync(scenePath)));
const poses = JSON.parse(readFileSync(posesPath, "utf8"));
let isOpen = false;
const opening = StreamedScene.open(link).finally(() => (isOpen = true));
const pass = async () => {
  now += STEP;
  link.step(STEP);
  const due = timers.filter(({ at }) => at <= now);
  timers = timers.filter(({ at }) => at > now);
  for (const { call } of due) call();
  await settle();
};
while (!isOpen) await pass();
const scene = await opening;
const abort = new AbortController();
visit = await Visit.begin(scene, {
  ...{ format: "packed", splatBudget: budget, signal: abort.signal, compensate: true },
});
const drawn = new Map();
const ended = (async () => {
  for await (const change of visit.changes()) {
    if (change.kind === "evicted") drawn.delete(change.chunk);
    else drawn.set(change.chunk, change.count);
    found.mostDrawn = Math.max(found.mostDrawn, [...drawn.values()].reduce((sum, count) => sum + count, 0));
  }
})().catch((error) => {
  if (!abort.signal.aborted) throw error;
});
const start = now;
let heapAt = start;
for (let tenth = 0; now - start < 1000 * seconds; ) {
  if (now - start >= 100 * tenth) {
    const turn = tenth++ % (2 * poses.length - 2);
    visit.setPose(poses[turn < poses.length ? turn : 2 * poses.length - 2 - turn]);
  }
  await pass();
  if (now < heapAt + 1000 * heapSeconds) continue;
  heapAt = now;
  globalThis.gc();
  const { heapUsed, arrayBuffers } = process.memoryUsage();
  found.heapMb.push(Math.round((heapUsed + arrayBuffers) / 1e5) / 10);
}
abort.abort();
await ended;
const output = { ...found, recorded, bytes: link.sent, fileBytes: link.bytes.length, splats: scene.info.splats };
process.stdout.write(JSON.stringify(output), () => process.exit(0));
