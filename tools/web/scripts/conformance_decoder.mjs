// This package behind the protocol of docs/conformance.md:
// cogsplat lab conformance run --decoder 'node scripts/conformance_decoder.mjs'
import { createHash } from "node:crypto";
import { existsSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { createInterface } from "node:readline";
import { BlobSource, CogsplatError, concatenate, loadKernels, SceneFile, StreamedScene } from "../dist/cogsplat.js";
import { folders } from "../dist/folders.js";

const VERSION = "0.1.0";
const makeKernels = await loadKernels();

/** A manifest on disk, with its objects in the same folder. */
class LocalManifest extends BlobSource {
  objects = new Map();

  constructor(path) {
    super(new Blob([readFileSync(path)]));
    this.folder = dirname(path);
  }

  relative(name) {
    const path = join(this.folder, name);
    if (!existsSync(path)) throw new CogsplatError("segment-missing", `${path} is not there`);
    this.objects.set(name, readFileSync(path));
    return new BlobSource(new Blob([this.objects.get(name)]));
  }

  /** Refuse objects read whose names are not the hash of their bytes (SPEC 3.4). */
  checkObjects() {
    for (const [name, bytes] of this.objects) {
      const digits = createHash("sha256").update(bytes).digest("hex").slice(0, 32);
      if (name !== `segments/${digits}.bin`) throw new CogsplatError("object-hash", name);
    }
  }
}

/** Decode a folder by the loader that reads it over a network. */
async function decodeFolder({ path, refine, verify }) {
  // By its name the request means a manifest; a scene is opened as what it begins with.
  if (readFileSync(path).subarray(0, 5).toString("latin1") === "\x89COGS") throw new CogsplatError("not-cogs", path);
  if (!refine) throw new Error("folders are decoded with their refinements");
  const source = new LocalManifest(path);
  const scene = await StreamedScene.open(source, { folders });
  const last = new Map();
  for await (const update of scene.stream()) last.set(update.chunk, update.splats);
  if (verify) source.checkObjects();
  const chunks = [...last.keys()].sort((a, b) => a - b);
  return concatenate(
    chunks.map((chunk) => last.get(chunk)),
    scene.info.shDegree,
  );
}

async function decodeFile({ path, partial, refine, verify }) {
  const file = new SceneFile(new Uint8Array(readFileSync(path)), makeKernels(), { partial });
  if (verify) await file.verify();
  return file.decode(undefined, refine);
}

async function decode(request) {
  const splats = request.path.endsWith(".cogsm") ? await decodeFolder(request) : await decodeFile(request);
  const { count, means, scales, quats, opacities, sh0, shN } = splats;
  writeFileSync(
    request.out,
    Buffer.concat([means, scales, quats, opacities, sh0, shN].map((array) => new Uint8Array(array.buffer))),
  );
  return { ok: true, splats: count };
}

for await (const line of createInterface({ input: process.stdin })) {
  const request = JSON.parse(line);
  let answer;
  if (request.op === "hello") {
    answer = { name: "cogsplat for the web", version: VERSION, level: "verifier", folders: true };
  } else {
    try {
      answer = await decode(request);
    } catch (error) {
      if (!(error instanceof CogsplatError)) throw error;
      answer = { ok: false, code: error.code };
    }
  }
  console.log(JSON.stringify(answer));
}
