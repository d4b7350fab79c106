// What a page needs to show a scene and to decode another one in workers.
import { DecoderPool, StreamedScene } from "cogsplat";
import "cogsplat/viewer";

async function countSplats() {
  const scene = await StreamedScene.open("scene.cogs", { service: (index) => new DecoderPool(index) });
  const rows = new Map();
  for await (const update of scene.stream({ format: "packed" })) rows.set(update.chunk, update.packed.count);
  return [...rows.values()].reduce((sum, count) => sum + count, 0);
}

countSplats().then(
  (splats) => (document.querySelector("output").textContent = `${splats} splats`),
  (error) => (document.querySelector("output").textContent = `failed: ${error.message}`),
);
