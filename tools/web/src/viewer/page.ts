// The program of viewer.html: `viewer.html?scene=URL`, or a file that is dropped onto the page.
import { StreamedScene } from "../loader/streamed_scene.js";
import type { ChunkUpdate } from "../loader/stream_options.js";
import { DecoderPool } from "../workers/decoder_pool.js";
import { OrbitCamera } from "./orbit.js";
import { SplatRenderer } from "./renderer.js";

const canvas = document.querySelector("canvas")!;
const status = document.querySelector("output")!;
let current: AbortController | undefined;

async function show(source: string | Blob): Promise<void> {
  current?.abort();
  const abort = new AbortController();
  current = abort;
  status.textContent = "opening …";
  const scene = await StreamedScene.open(source, { signal: abort.signal, service: (index) => new DecoderPool(index) });
  const { info } = scene;
  const renderer = new SplatRenderer(canvas, info, info.shDegree);
  const camera = new OrbitCamera(info);
  let dirty = true;
  control(camera, abort.signal, () => (dirty = true));
  const frame = (): void => {
    if (abort.signal.aborted) {
      renderer.delete();
      return;
    }
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((px) => Math.round(px * devicePixelRatio));
    if (dirty || canvas.width !== width || canvas.height !== height) {
      [canvas.width, canvas.height] = [width!, height!];
      dirty = false;
      renderer.draw(camera.view(canvas.height));
    }
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);

  const given = new Map<number, ChunkUpdate>();
  /** Chunks that were written with what they add for missing ones. */
  const shifted = new Set<number>();
  let rows = 0;
  for await (const update of scene.stream({ signal: abort.signal, format: "packed", compensate: true })) {
    if (!given.has(update.chunk)) rows += update.count;
    given.set(update.chunk, update);
    // Earlier chunks make up for a little less with every chunk that comes.
    for (const { chunk, packed, firstRow } of given.values()) {
      const shifts = chunk < update.prefix ? scene.compensation.shifts(update.prefix, chunk) : undefined;
      if (chunk !== update.chunk && shifts === undefined && !shifted.has(chunk)) continue;
      renderer.write(packed!, firstRow, shifts);
      if (shifts === undefined) shifted.delete(chunk);
      else shifted.add(chunk);
    }
    dirty = true;
    status.textContent = `${rows.toLocaleString()} of ${info.splats.toLocaleString()} splats`;
  }
  status.textContent = `${info.splats.toLocaleString()} splats`;
}

/** Turn with the pointer, move with shift or the right button, come nearer with the wheel. */
function control(camera: OrbitCamera, signal: AbortSignal, changed: () => void): void {
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId), { signal });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault(), { signal });
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons === 0) return;
    if (event.shiftKey || event.buttons === 2) camera.move(event.movementX, event.movementY, canvas.clientHeight);
    else camera.turn(event.movementX, event.movementY);
    changed();
  }, { signal });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.zoom(Math.exp(event.deltaY / 1000));
    changed();
  }, { signal, passive: false });
}

function report(error: unknown): void {
  if (error instanceof Error && error.name === "AbortError") return;
  status.textContent = error instanceof Error ? error.message : String(error);
}

document.addEventListener("dragover", (event) => event.preventDefault());
document.addEventListener("drop", (event) => {
  event.preventDefault();
  const file = event.dataTransfer?.files[0];
  if (file) show(file).catch(report);
});
const scene = new URLSearchParams(location.search).get("scene");
if (scene === null) status.textContent = "Drop a .cogs file here, or open this page with ?scene=URL.";
else show(new URL(scene, location.href).href).catch(report);
