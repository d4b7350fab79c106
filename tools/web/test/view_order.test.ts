import assert from "node:assert/strict";
import { test } from "node:test";
import { loadKernels } from "../src/kernels/load.js";
import { StreamedScene } from "../src/loader/streamed_scene.js";
import { byView, ViewOrder } from "../src/loader/view_order.js";
import type { Pose } from "../src/schedule/poses.js";
import { SceneFile } from "../src/scene/scene_file.js";
import { RangeServer } from "./range_server.js";
import { sha256, vectorBytes } from "./vectors.js";
import { padSegments } from "./padded_file.js";

const kernels = await loadKernels();

/** Looks along +z, or turned about by half. */
function looking(back = false): Pose {
  const sign = back ? -1 : 1;
  return { position: [0, 0, 0], rotation: [sign, 0, 0, 0, 1, 0, 0, 0, sign], tanX: 1, tanY: 1 };
}

/** An index of a first chunk around the eye, one ahead and one behind, each a head, then the refinements. */
function smallIndex(): ConstructorParameters<typeof ViewOrder>[0] {
  const boxes = [[-9, -9, -9, 9, 9, 9], [-1, -1, 4, 1, 1, 6], [-1, -1, -6, 1, 1, -4]];
  return {
    segments: {
      kind: Uint8Array.from([1, 1, 1, 7, 7, 7]),
      owner: Uint32Array.from([0, 1, 2, 0, 1, 2]),
    },
    chunks: {
      splats: Uint32Array.from([5, 5, 5]),
      box: Float32Array.from(boxes.flat()),
      contribution: Float64Array.from([1, 1, 1]),
      cell: Uint32Array.from([1, 2, 3]),
    },
    complete: true,
    range: (segment: number) => ({ offset: 100 * segment, length: 100 }),
    codebookSegmentsOf: () => [],
  } as unknown as ConstructorParameters<typeof ViewOrder>[0];
}

test("what the pose shows comes first, behind its parents", () => {
  let back = false;
  const order = new ViewOrder(smallIndex(), () => looking(back));
  // What lies around the eye shows most, then what is ahead; every head stands behind its parent's.
  assert.deepEqual(order.order([2, 1, 0, 5, 4, 3], 0), [0, 3, 1, 4, 2, 5]);
  back = true;
  const turned = order.order([1, 2, 4, 5], 9);
  assert.ok(turned.indexOf(2) < turned.indexOf(1));
  assert.ok(turned.indexOf(5) < turned.indexOf(4));
  // A refinement waits for its head, not for that of another chunk.
  assert.deepEqual(order.order([4, 5], 18), [5, 4]);
});

for (const name of ["chunks", "vq", "two-books", "refinements", "view-table", "compensation-cells"]) {
  test(`${name} streams by a pose to the same rows`, async () => {
    const bytes = vectorBytes("valid", name);
    const server = new RangeServer(padSegments(bytes, 70_000));
    const url = await server.start();
    try {
      const scene = await StreamedScene.open(url);
      const last = new Map<number, string>();
      for await (const { chunk, splats } of scene.stream({ order: byView(() => looking()) })) {
        last.set(chunk, sha256(splats!.means, splats!.opacities, splats!.shN));
      }
      const file = new SceneFile(bytes, kernels());
      const expected = Array.from({ length: file.index.chunkCount }, (_, chunk) => {
        const { means, opacities, shN } = file.decodeChunk(chunk);
        return [chunk, sha256(means, opacities, shN)] as const;
      });
      assert.deepEqual([...last].sort(([a], [b]) => a - b), expected);
    } finally {
      await server.stop();
    }
  });
}
