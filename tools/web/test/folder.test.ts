import assert from "node:assert/strict";
import { test } from "node:test";
import { CogsplatError } from "../src/errors.js";
import { loadKernels } from "../src/kernels/load.js";
import { folders } from "../src/loader/folders.js";
import type { ChunkUpdate, StreamOptions } from "../src/loader/stream_options.js";
import { manifestAddress, StreamedScene } from "../src/loader/streamed_scene.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { FolderServer } from "./folder_server.js";
import { manifest, sha256, vectorBytes, vectorFolder } from "./vectors.js";

const FAST_RETRY = { retries: 3, pause: 1, longest: 4 };
const kernels = await loadKernels();

/** Open a folder on a server, use its scene, and return the requests. */
async function withScene(
  server: FolderServer,
  name: string,
  work: (scene: StreamedScene) => Promise<void>,
): Promise<string[]> {
  const url = await server.start();
  try {
    await work(await StreamedScene.open(url + name, { retry: FAST_RETRY, folders }));
    return server.asked;
  } finally {
    await server.stop();
  }
}

async function lastUpdates(scene: StreamedScene, options: StreamOptions = {}): Promise<Map<number, ChunkUpdate>> {
  const last = new Map<number, ChunkUpdate>();
  for await (const update of scene.stream(options)) last.set(update.chunk, update);
  return last;
}

function checkRows(file: SceneFile, chunk: number, { splats }: ChunkUpdate): void {
  const expected = file.decodeChunk(chunk);
  assert.equal(
    sha256(splats!.means, splats!.opacities, splats!.shN),
    sha256(expected.means, expected.opacities, expected.shN),
  );
}

for (const { name, manifests } of manifest.folders) {
  for (const [given, standsFor] of Object.entries(manifests)) {
    for (const ranges of [true, false]) {
      test(`${name}/${given} is ${standsFor} ${ranges ? "by ranges" : "from a server without ranges"}`, async () => {
        const file = new SceneFile(vectorBytes("valid", standsFor), kernels());
        const server = new FolderServer(vectorFolder("folders", name), { ranges });
        // A folder is asked for its own manifest, where it has one of that name.
        const asked = await withScene(server, given === "manifest.cogsm" ? "" : given, async (scene) => {
          assert.ok(scene.isFolder);
          const last = await lastUpdates(scene);
          const drawn = [...file.index.chunks.until.keys()].filter((chunk) =>
            file.index.isDrawn(chunk, file.index.chunkCount),
          );
          assert.deepEqual(
            [...last.keys()].sort((a, b) => a - b),
            drawn,
          );
          for (const [chunk, update] of last) checkRows(file, chunk, update);
        });
        // What a server without ranges sends whole is asked for once.
        if (!ranges) assert.equal(new Set(asked).size, asked.length);
      });
    }
  }
}

for (const { name, code, stage } of manifest.invalid_folders) {
  // At its address a file is taken as the file that it is; names of objects are a verifier's business.
  if (name === "folder-file" || name === "folder-magic" || stage === "verify") continue;
  test(`${name} is refused with ${code}`, async () => {
    const server = new FolderServer(vectorFolder("invalid-folders", name));
    const url = await server.start();
    const open = async (): Promise<StreamedScene> => StreamedScene.open(url, { retry: FAST_RETRY, folders });
    const isRefused = (error: unknown): boolean => error instanceof CogsplatError && error.code === code;
    try {
      await assert.rejects(async () => lastUpdates(await open()), isRefused);
    } finally {
      await server.stop();
    }
  });
}

/** Return the names of the objects that hold the index pages of a folder. */
async function pageObjects(files: ReadonlyMap<string, Uint8Array>): Promise<string[]> {
  const asked = await withScene(new FolderServer(files), "", async (scene) => {
    while (!scene.index.complete) await scene.readNextPage();
  });
  return asked.slice(1);
}

test("one chunk takes its object, that of the codebooks and the pages", async () => {
  const files = vectorFolder("folders", "pages");
  const pages = await pageObjects(files);
  assert.equal(pages.length, 3);
  const whole = new SceneFile(vectorBytes("valid", "pages"), kernels());
  const wanted = whole.index.chunkCount - 1;
  const asked = await withScene(new FolderServer(files), "manifest.cogsm?key=1", async (scene) => {
    const last = await lastUpdates(scene, { priority: ({ chunk }) => (chunk === wanted ? 1 : -1) });
    assert.deepEqual([...last.keys()], [wanted]);
    checkRows(whole, wanted, last.get(wanted)!);
  });
  const rest = asked.filter((path) => !pages.includes(path));
  assert.ok(rest.length <= 3 && asked.length === rest.length + pages.length, asked.join(" "));
});

test("a page that came damaged is asked for once more", async () => {
  const files = vectorFolder("folders", "pages");
  const whole = new SceneFile(vectorBytes("valid", "pages"), kernels());
  const page = (await pageObjects(files))[0]!;
  for (const at of [8, files.get(page)!.length - 8]) {
    const damage = (body: Buffer, number: number, path: string): void => {
      if (path === page && number === 1) body[at]! ^= 1;
    };
    const asked = await withScene(new FolderServer(files, { damage }), "", async (scene) => {
      await scene.readNextPage();
      assert.equal((await lastUpdates(scene)).size, whole.index.chunkCount);
    });
    assert.equal(asked.filter((path) => path === page).length, 2);
  }
});

test("a description in the manifest takes no further request", async () => {
  const files = vectorFolder("folders", "pictures-pages");
  const asked = await withScene(new FolderServer(files), "", async (scene) => {
    assert.notEqual(await scene.description(), undefined);
  });
  assert.deepEqual(asked, ["manifest.cogsm"]);
});

test("a description in the manifest that came damaged is asked for once more", async () => {
  const files = vectorFolder("folders", "pictures-pages");
  const damage = (body: Buffer, number: number): void => {
    if (number === 0) body[body.length - 1]! ^= 1;
  };
  const asked = await withScene(new FolderServer(files, { damage }), "", async (scene) => {
    assert.notEqual(await scene.description(), undefined);
  });
  assert.deepEqual(asked, ["manifest.cogsm", "manifest.cogsm"]);
});

test("an object that is not there spoils no other", async () => {
  const files = vectorFolder("folders", "pages");
  const whole = new SceneFile(vectorBytes("valid", "pages"), kernels());
  const others = new Set(["manifest.cogsm", ...(await pageObjects(files))]);
  const asked = await withScene(new FolderServer(files), "", async (scene) => void (await lastUpdates(scene)));
  const sizes = [...files]
    .filter(([path]) => asked.includes(path) && !others.has(path))
    .sort(([, a], [, b]) => a.length - b.length);
  files.delete(sizes[0]![0]);
  const damaged: unknown[] = [];
  await withScene(new FolderServer(files), "", async (scene) => {
    const last = await lastUpdates(scene, {
      onDamage: (error) => damaged.push(error instanceof CogsplatError ? error.code : error),
    });
    assert.ok(last.size >= whole.index.chunkCount - 1);
  });
  assert.deepEqual([...new Set(damaged)], ["segment-missing"]);
});

test("without what reads folders, that is told", async () => {
  const server = new FolderServer(vectorFolder("folders", "pages"));
  const url = await server.start();
  await assert.rejects(StreamedScene.open(url), /needs the option `folders`/);
  await server.stop();
});

test("addresses of folders end in a slash", () => {
  assert.equal(manifestAddress("https://example.org/scene/?v=2"), "https://example.org/scene/manifest.cogsm?v=2");
  assert.equal(manifestAddress("scene/"), "scene/manifest.cogsm");
  assert.equal(manifestAddress("https://example.org/scene.cogs?at=a/"), "https://example.org/scene.cogs?at=a/");
});
