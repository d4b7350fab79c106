import assert from "node:assert/strict";
import { test } from "node:test";
import { readDescription } from "../src/container/description.js";
import { readPictureHeader } from "../src/container/picture_header.js";
import { CogsplatError } from "../src/errors.js";
import { folders } from "../src/loader/folders.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { FolderServer } from "./folder_server.js";
import { padSegments } from "./padded_file.js";
import { RangeServer } from "./range_server.js";
import { manifest, sha256, type ValidVector, vectorBytes, vectorFolder } from "./vectors.js";

const FAST_RETRY = { retries: 3, pause: 1, longest: 4 };

const blobOf = (name: string): Blob => new Blob([new Uint8Array(vectorBytes("valid", name))]);

function picturesOf(name: string): NonNullable<ValidVector["pictures"]> {
  return manifest.valid.find((vector) => vector.name === name)!.pictures!;
}

async function checkPictures(scene: StreamedScene, name: string): Promise<void> {
  for (const key of ["poster", "sky"] as const) {
    const expected = picturesOf(name)[key];
    const picture = await scene.picture(key);
    assert.equal(picture?.type, expected?.[0]);
    if (picture) assert.equal(sha256(new Uint8Array(await picture.arrayBuffer())), expected![3]);
  }
}

for (const name of ["pictures", "pictures-pages", "pictures-alpha"]) {
  test(`the description and pictures of ${name} are fetched`, async () => {
    const scene = await StreamedScene.open(blobOf(name));
    const description = await scene.description();
    assert.equal(description?.poster?.width, picturesOf(name).poster?.[1]);
    await checkPictures(scene, name);
  });
}

test("a scene without a description has none", async () => {
  const scene = await StreamedScene.open(blobOf("sh1"));
  assert.equal(await scene.description(), undefined);
  assert.equal(await scene.picture("sky"), undefined);
});

test("a description comes with the manifest of a folder, and a stream fetches none of its pictures", async () => {
  const server = new FolderServer(vectorFolder("folders", "pictures-pages"));
  const url = await server.start();
  try {
    const scene = await StreamedScene.open(url, { retry: FAST_RETRY, folders });
    for await (const _ of scene.stream());
    const streamed = server.asked.length;
    await scene.description();
    assert.equal(server.asked.length, streamed);
    await checkPictures(scene, "pictures-pages");
    const objects = new Set(server.asked.filter((path) => path.endsWith(".bin")));
    // Two chunks, a page and two pictures.
    assert.equal(objects.size, 5);
  } finally {
    await server.stop();
  }
});

test("a description that was damaged on the way is fetched again", async () => {
  // Longer than the first request, with the description behind it.
  const file = padSegments(vectorBytes("valid", "description-markup"), 100_000);
  const server = new RangeServer(file, (number) => (number === 1 ? "flip" : undefined));
  const url = await server.start();
  try {
    const scene = await StreamedScene.open(url, { retry: FAST_RETRY });
    const description = await scene.description();
    assert.match(description!.title!, /^<img src=x onerror=/);
    assert.equal(server.ranges.length, 3);
  } finally {
    await server.stop();
  }
});

test("a picture whose header lies never becomes a Blob", async () => {
  for (const name of ["picture-bomb", "picture-webp-bomb", "picture-canvas", "picture-type", "picture-cut"]) {
    const scene = await StreamedScene.open(new Blob([new Uint8Array(vectorBytes("invalid", name))]));
    assert.ok(await scene.description(), name);
    await assert.rejects(scene.picture("poster"), (error) => {
      assert.ok(error instanceof CogsplatError);
      return error.code === "picture-header";
    });
  }
});

test("every beginning of a picture is refused", async () => {
  const scenes = ["pictures", "pictures-progressive", "pictures-alpha"];
  for (const name of scenes) {
    const scene = await StreamedScene.open(blobOf(name));
    for (const key of ["poster", "sky"] as const) {
      const picture = await scene.picture(key);
      if (picture === undefined) continue;
      const bytes = new Uint8Array(await picture.arrayBuffer());
      for (let length = 0; length < bytes.length; length++) {
        assert.throws(() => readPictureHeader(bytes.slice(0, length)), CogsplatError, `${length} bytes of ${name}`);
      }
    }
  }
});

test("ten megabytes of text are refused before they are shown", () => {
  const text = new Uint8Array(10_000_000).fill(0x78);
  const head = [0x81, 0xa4, ...new TextEncoder().encode("text"), 0xdb, 0, 0x98, 0x96, 0x80];
  const payload = new Uint8Array(head.length + text.length);
  payload.set(head);
  payload.set(text, head.length);
  assert.throws(
    () => readDescription(payload),
    (error) => error instanceof CogsplatError && error.code === "root-value",
  );
});
