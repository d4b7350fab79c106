// Cases of a hostile server: made from a seed, kept as JSON, run against the loader.
import { CogsplatError, SourceError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import type { ChunkRows } from "../src/loader/scene_fetch.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { Visit } from "../src/loader/visit.js";
import type { DecoderIndex } from "../src/scene/chunk_decoder.js";
import { SceneFile } from "../src/scene/scene_file.js";
import type { Pose } from "../src/schedule/poses.js";
import { type ChunkService, type DecodedChunk, type DecodeTask, InlineService } from "../src/workers/decode_task.js";
import { padSegments } from "./padded_file.js";
import { type Fault, ScriptedServer } from "./scripted_server.js";
import { sha256, vectorBytes } from "./vectors.js";

/** A server's answers, and what a client does with them. */
export interface Case {
  /** Conformance file that is served. */
  readonly vector: string;
  /** Conformance file of the answers with `Fault.other`. */
  readonly other: string;
  /** Bytes of a segment that is skipped, so that the file is longer than the first request. */
  readonly padding: number;
  /** Bytes of the file that are changed: place and mask. */
  readonly flips: readonly (readonly [number, number])[];
  /** Faults of the first requests; null for none. */
  readonly faults: readonly (Fault | null)[];
  /** Fault of all later requests. */
  readonly rest: Fault | null;
  readonly client: "stream" | "visit";
  /** Splats of a visit at most; 0 for all. */
  readonly budget: number;
  /** Number of poses of a visit, and the longest time between two, ms. */
  readonly poses: readonly [number, number];
  /** Longest time of a decoded chunk, ms. */
  readonly decoding: number;
  /** Whether damage is reported, so that the fetch goes on without the segment. */
  readonly reports: boolean;
}

/** How a case ended: complete, or with the name or code of an error. */
export interface Outcome {
  readonly end: string;
  readonly requests: number;
  readonly bytes: number;
}

const VECTORS = ["chunks", "vq", "two-books", "refinements", "view-table", "compensation-cells"];
const STATUSES = [200, 201, 204, 206, 301, 304, 400, 403, 404, 408, 410, 412, 416, 429, 500, 503, 599];
/** Longest time without progress, ms. */
const LONGEST_PAUSE = 60;
const RETRY = { retries: 2, pause: 1, longest: 2, longestWait: 20 };
/** Requests of a case at most: segments by attempts, and some. */
const MOST_REQUESTS = 400;
/** Time after which a case counts as hanging, ms: a loaded machine is slow. */
const DEADLINE = 60_000;

const kernels = await loadKernels();

/** Return numbers from 0 to 1 that follow from a seed (mulberry32). */
export function randomNumbers(seed: number): () => number {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let mixed = Math.imul(state ^ (state >>> 15), state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

/** Make the case of a seed. */
export function makeCase(seed: number): Case {
  const random = randomNumbers(seed);
  const below = (count: number): number => Math.floor(random() * count);
  const one = <T>(values: readonly T[]): T => values[below(values.length)]!;
  const isHostile = random() < 0.85;
  const place = (): number => one([0, 1, 4, 8, 60, 64, 100, below(1000), below(70_000), below(200_000)]);
  const fault = (): Fault => {
    switch (below(16)) {
      case 0:
        return {
          status: one(STATUSES),
          ...(random() < 0.3 && {
            headers: {
              "Retry-After": one(["0", "1", "x", "9e9", "-1", "Sun, 22 Nov 2026 07:00:05 GMT", "99999999999999999999"]),
            },
          }),
        };
      case 1:
        return { shift: [one([0, 0, 1, -1, 1e9]), one([0, 0, 1, -1, 1e6]), one([0, 1, -1, 1e12, -100])] };
      case 2:
        return { headers: { "Content-Length": one([null, "0", "1", "-1", "1e9", "99999999999999999999", "abc", ""]) } };
      case 3:
        return {
          headers: {
            "Content-Range": one([
              null,
              "bytes */*",
              "bytes 0-0/1",
              "bytes 9-1/5",
              "items 0-1/2",
              "bytes 0-99999999999999999999/*",
              "",
            ]),
          },
        };
      case 4:
        return { headers: { "Content-Encoding": one(["gzip", "br", "identity", "", "zstd"]) } };
      case 5:
        return { headers: { "Content-Type": one(["multipart/byteranges; boundary=x", "text/html", "", "é"]) } };
      case 6:
        return { headers: { ETag: one([null, '"c"', 'W/"c"', "", "x"]) } };
      case 7:
        return { other: true, ...(random() < 0.5 && { headers: { ETag: '"a"' } }) };
      case 8:
        return { flips: Array.from({ length: 1 + below(3) }, () => [place(), 1 << below(8)] as const) };
      case 9:
        return { end: place(), ending: one(["close", "error", "stall"]) };
      case 10:
        return { behind: one([1, 100, 100_000, -1]), ...(random() < 0.5 && { headers: { "Content-Length": null } }) };
      case 11:
        return { whole: true, ...(random() < 0.5 && { headers: { "Content-Length": one([null, "64", "1"]) } }) };
      case 12:
        return { part: one([1, 7, 100, 4096]), pause: one([0, 0, 1, 20]) };
      case 13:
        return { instead: one(["TypeError", "RangeError", "text", "nothing"]) };
      case 14:
        return random() < 0.5 ? { empty: true } : { most: one([1, 100, 20_000]) };
      default:
        return { delay: below(30) };
    }
  };
  const maybe = (share: number): Fault | null => {
    if (random() >= share) return null;
    return random() < 0.3 ? { ...fault(), ...fault() } : fault();
  };
  const visits = random() < 0.6;
  return {
    vector: one(VECTORS),
    other: one(VECTORS),
    padding: one([0, 70_000, 70_000, 150_000]),
    flips: random() < 0.1 ? [[place(), 1 << below(8)]] : [],
    faults: isHostile ? Array.from({ length: below(12) }, () => maybe(0.5)) : [],
    rest: isHostile ? maybe(0.25) : random() < 0.5 ? { delay: 1 + below(8), part: 64, pause: 1 } : null,
    client: visits ? "visit" : "stream",
    budget: visits && random() < 0.6 ? 3 + below(12) : 0,
    poses: visits ? [below(9), one([0, 5, 30, 120])] : [0, 0],
    decoding: one([0, 0, 3, 20]),
    reports: random() < 0.5,
  };
}

/** A decoder whose chunks take some time. */
class SlowService implements ChunkService {
  constructor(
    private readonly inner: InlineService,
    private readonly random: () => number,
    private readonly longest: number,
  ) {}

  addCodebook(codebook: number, kind: number, payload: Uint8Array): void {
    this.inner.addCodebook(codebook, kind, payload);
  }

  async decode(task: DecodeTask): Promise<DecodedChunk> {
    if (this.longest > 0) await pause(this.longest * this.random());
    return this.inner.decodeNow(task);
  }

  close(): void {
    this.inner.close();
  }
}

async function pause(milliseconds: number): Promise<void> {
  await new Promise((resolve) => setTimeout(resolve, milliseconds));
}

/** Hashes of the rows of each chunk: of the head alone, and of each later state. */
function rowsOf(file: Uint8Array): Map<number, Set<string>> {
  const whole = new SceneFile(file, kernels());
  const { shDegree } = whole.scene;
  return new Map(
    Array.from({ length: whole.index.chunkCount }, (_, chunk) => [
      chunk,
      new Set(
        [0, shDegree].flatMap((degree) =>
          [false, true].map((refine) => hashOf(whole.decodeChunk(chunk, degree, refine))),
        ),
      ),
    ]),
  );
}

function hashOf({ means, scales, quats, opacities, sh0, shN }: NonNullable<ChunkRows["splats"]>): string {
  // Bands that have not arrived are zeros, those not decoded no values.
  return sha256(means, scales, quats, opacities, sh0, shN.some((value) => value !== 0) ? shN : new Float32Array(0));
}

const files = new Map<
  string,
  { readonly bytes: Uint8Array; readonly rows: ReadonlyMap<number, ReadonlySet<string>> }
>();

function served(vector: string, padding: number) {
  const key = `${vector} ${padding}`;
  if (!files.has(key)) {
    const bytes = vectorBytes("valid", vector);
    files.set(key, { bytes: padding === 0 ? bytes : padSegments(bytes, padding), rows: rowsOf(bytes) });
  }
  return files.get(key)!;
}

/**
 * Run a case; it ends with rows of the file or with an error of the loader.
 *
 * @throws Error where the loader breaks a promise: wrong rows, another error, too many requests or bytes, no end.
 */
export async function runCase(given: Case, seed = 1): Promise<Outcome> {
  const random = randomNumbers(seed);
  const { bytes, rows } = served(given.vector, given.padding);
  const other = served(given.other, given.padding);
  const file = bytes.slice();
  for (const [place, mask] of given.flips) file[place % file.length]! ^= mask;
  const server = new ScriptedServer(file, (number) => given.faults[number] ?? given.rest ?? undefined, other.bytes);
  const abort = new AbortController();
  const held = new Map<number, string>();
  const fail = (problem: string): never => {
    throw new Error(`${problem}, after ${server.ranges.length} requests and ${server.bytes} bytes`);
  };
  const take = (change: ChunkRows): void => {
    held.set(change.chunk, hashOf(change.splats!));
    const isRight = [rows, other.rows].some((known) => known.get(change.chunk)?.has(held.get(change.chunk)!));
    if (!isRight) fail(`wrong rows of chunk ${change.chunk}`);
  };
  const onDamage = given.reports ? (): void => undefined : undefined;
  const work = async (): Promise<void> => {
    const scene = await StreamedScene.open("http://scripted.invalid/scene.cogs", {
      signal: abort.signal,
      http: { ...server.http, longestPause: LONGEST_PAUSE },
      retry: RETRY,
      service: async (index: DecoderIndex) =>
        new SlowService(new InlineService(index, kernels), random, given.decoding),
    });
    const options = { signal: abort.signal, ...(onDamage && { onDamage }) };
    if (given.client === "stream" || !scene.answersRanges)
      for await (const update of scene.stream(options)) take(update);
    else await visit(scene, options);
  };
  const visit = async (
    scene: StreamedScene,
    options: { signal: AbortSignal; onDamage?: () => void },
  ): Promise<void> => {
    let isSettled = false;
    let wake: () => void = () => undefined;
    const begun = await Visit.begin(scene, {
      ...options,
      ...(given.budget > 0 && { splatBudget: given.budget }),
      onSettled: (now) => {
        isSettled = now;
        wake();
      },
    });
    let hasEnded = false;
    const changes = (async () => {
      for await (const change of begun.changes()) {
        if (change.kind === "rows") take(change);
        else if (!held.delete(change.chunk)) fail(`chunk ${change.chunk} evicted twice`);
        const splats = [...held.keys()].reduce((sum, chunk) => sum + scene.index.chunks.splats[chunk]!, 0);
        if (given.budget > 0 && splats > given.budget) fail(`${splats} splats of ${given.budget}`);
      }
    })().finally(() => {
      hasEnded = true;
      wake();
    });
    changes.catch(() => undefined);
    for (let number = 0; number < given.poses[0] && !hasEnded; number++) {
      begun.setPose(poseOf(random));
      if (random() < 0.2) await Promise.resolve();
      else await pause(given.poses[1] * random());
    }
    while (!isSettled && !hasEnded) await new Promise<void>((resolve) => (wake = resolve));
    if (!hasEnded) abort.abort(new Error("settled"));
    await changes;
  };
  let timer: ReturnType<typeof setTimeout> | undefined;
  const deadline = new Promise<never>((_, reject) => {
    timer = setTimeout(() => {
      try {
        fail("no end");
      } catch (error) {
        reject(error as Error);
      }
    }, DEADLINE);
  });
  let end = "complete";
  try {
    await Promise.race([work(), deadline]);
  } catch (error) {
    if (error instanceof CogsplatError) end = error.code;
    else if (error instanceof SourceError) end = `SourceError ${error.status ?? ""}`.trim();
    else if (error instanceof Error && error.message === "settled") end = "settled";
    else throw error;
  } finally {
    clearTimeout(timer);
    abort.abort(new Error("over"));
  }
  if (server.ranges.length > MOST_REQUESTS) fail("too many requests");
  // Each request takes at most the bytes before its end, and those of one part more.
  const most = server.ranges.reduce((sum, [, last]) => sum + Math.min(last + 1, file.length) + 2 * 65_536, 0);
  if (server.bytes > most) fail(`more than ${most} bytes`);
  for (let turn = 0; turn < 200 && server.open > 0; turn++) await pause(1);
  if (server.open > 0) fail(`${server.open} answers are left open`);
  return { end, requests: server.ranges.length, bytes: server.bytes };
}

function poseOf(random: () => number): Pose {
  const angle = 2 * Math.PI * random();
  const [sin, cos] = [Math.sin(angle), Math.cos(angle)];
  return {
    position: [0, 1, 2].map(() => 20 * random() - 10),
    rotation: [cos, 0, -sin, 0, 1, 0, sin, 0, cos],
    tanX: 1,
    tanY: 1,
  };
}
