import assert from "node:assert/strict";
import { test } from "node:test";
import { DEFAULT_RANGES, type PackedSplats } from "../src/scene/packed_splats.js";
import { DepthSorter } from "../src/viewer/depth_sorter.js";
import { TEXTURE_WIDTH } from "../src/viewer/shaders.js";
import { SplatLayer } from "../src/viewer/splat_layer.js";

/** A WebGL context that counts the bytes of its textures. */
class CountingContext {
  readonly textures = new Map<object, number>();
  private bound: object | undefined;
  readonly copies: number[] = [];
  /** Texture, first line and lines of each upload. */
  uploads: { readonly texture: object; readonly line: number; readonly lines: number }[] = [];

  /** Bytes of all textures. */
  get bytes(): number {
    return [...this.textures.values()].reduce((sum, bytes) => sum + bytes, 0);
  }

  get context(): WebGL2RenderingContext {
    const calls: Record<string, unknown> = {
      getParameter: () => 4096,
      createTexture: () => ({}),
      createFramebuffer: () => ({}),
      bindTexture: (_target: number, texture: object) => {
        this.bound = texture;
      },
      texStorage2D: (_target: number, _levels: number, format: number, width: number, height: number) => {
        this.textures.set(this.bound!, format * width * height);
      },
      deleteTexture: (texture: object) => this.textures.delete(texture),
      texSubImage2D: (...parts: number[]) => {
        this.uploads.push({ texture: this.bound!, line: parts[3]!, lines: parts[5]! });
      },
      copyTexSubImage2D: (...parts: number[]) => this.copies.push(parts[7]!),
      R32UI: 4,
      RG32UI: 8,
      RGBA32UI: 16,
    };
    // Other calls do nothing, other constants are 0.
    return new Proxy(calls, {
      get: (known, name: string) => known[name] ?? (/^[A-Z0-9_]+$/.test(name) ? 0 : () => undefined),
    }) as unknown as WebGL2RenderingContext;
  }
}

const chunk = (count: number): PackedSplats =>
  ({ count, words: new Uint32Array(4 * count).fill(7), means: new Float32Array(3 * count), sh: [] }) as never;
const SCENE = { splats: 8 * TEXTURE_WIDTH, shDegree: 0, origin: [0, 0, 0], linear: false, kernelPx: 0.3 };
const PLANE = { forward: [0, 0, 1], depth: 0 };

async function whenSorted(layer: SplatLayer): Promise<void> {
  while (!layer.prepare(PLANE)) await new Promise((resolve) => setTimeout(resolve, 1));
}

test("released rows leave the GPU's memory once they are not drawn, at the end of a chunk", async () => {
  const gpu = new CountingContext();
  const layer = new SplatLayer(
    gpu.context,
    { ...SCENE, antialiased: false, capture: [], hasLevels: false },
    DEFAULT_RANGES,
    Infinity,
    (rows) => new DepthSorter(rows, undefined, assert.fail),
    () => undefined,
  );
  for (let i = 0; i < 8; i++) layer.write(chunk(TEXTURE_WIDTH), i * TEXTURE_WIDTH);
  await whenSorted(layer);
  const before = gpu.bytes;
  assert.equal(before, (16 + 8 + 4 + 4) * 8 * TEXTURE_WIDTH);
  layer.release(2 * TEXTURE_WIDTH + 5);
  assert.equal(gpu.bytes, before);
  await whenSorted(layer);
  assert.equal(gpu.bytes, before / 4);
  // What stays is copied on the GPU, in each of four textures.
  assert.deepEqual(gpu.copies, [2, 2, 2, 2]);
  assert.equal(layer.capacity, 2 * TEXTURE_WIDTH);
  assert.equal(layer.drawnRows, 2 * TEXTURE_WIDTH);
  // A chunk that arrives later finds no room, and changes nothing.
  layer.write(chunk(TEXTURE_WIDTH), 2 * TEXTURE_WIDTH);
  layer.clear(2 * TEXTURE_WIDTH, TEXTURE_WIDTH);
  await whenSorted(layer);
  assert.equal(layer.rows, 2 * TEXTURE_WIDTH);
  layer.close();
  assert.equal(gpu.bytes, 0);
});

test("an order is uploaded as a whole, in runs of adjacent lines, and again when the view has turned", async () => {
  const gpu = new CountingContext();
  const lines = 80;
  const layer = new SplatLayer(
    gpu.context,
    { ...SCENE, splats: lines * TEXTURE_WIDTH, antialiased: false, capture: [], hasLevels: false },
    DEFAULT_RANGES,
    Infinity,
    (rows) => new DepthSorter(rows, undefined, assert.fail),
    () => undefined,
  );
  layer.write(chunk(lines * TEXTURE_WIDTH), 0);
  await whenSorted(layer);
  while (!layer.upload()) assert.ok(gpu.uploads.length < 1000);
  for (const forward of [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
  ]) {
    gpu.uploads = [];
    const plane = { forward, depth: 0 };
    while (!layer.prepare(plane)) await new Promise((resolve) => setTimeout(resolve, 1));
    assert.ok(layer.upload());
    // The order alone has changed.
    assert.equal(new Set(gpu.uploads.map(({ texture }) => texture)).size, 1);
    assert.deepEqual(
      gpu.uploads.map((upload) => [upload.line, upload.lines]),
      [
        [0, 32],
        [32, 32],
        [64, 16],
      ],
    );
  }
  layer.close();
});
