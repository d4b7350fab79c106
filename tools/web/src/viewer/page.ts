// The program of viewer.html: `viewer.html?scene=URL`, a scene that the page names or holds itself, or a file that is
// dropped onto it.
import type { DecoderIndex } from "../scene/chunk_decoder.js";
import { StreamedScene } from "../loader/streamed_scene.js";
import type { ChunkUpdate } from "../loader/stream_options.js";
import { DecoderPool } from "../workers/decoder_pool.js";
import { OrbitCamera } from "./orbit.js";
import { SplatRenderer } from "./renderer.js";
import type { ViewerPose, ViewerStatistics } from "./viewer_handle.js";

const canvas = document.querySelector("canvas")!;
const status = document.querySelector("output")!;
/** Blocks of a page that holds its scene: the file's bytes in base64, a part of them each. */
const SCENE_BLOCKS = 'script[type="application/x-cogs-base64"]';
let current: AbortController | undefined;

let pose: ViewerPose | undefined;
/** Tells the picture that is shown to follow `pose`. */
let poseChanged = (): void => undefined;
let statistics: ViewerStatistics = { state: "empty", splats: 0, totalSplats: 0, frames: 0, upToDate: false };
const note = (changes: Partial<ViewerStatistics>): void => void (statistics = { ...statistics, ...changes });

window.cogsplatViewer = {
  get statistics() {
    return statistics;
  },
  get view() {
    return pose;
  },
  set view(view) {
    pose = view;
    poseChanged();
  },
};

/** Show a scene; `inWorkers` is false where the page is a lone file, beside which there is no program of workers. */
async function show(source: string | Blob, inWorkers = true): Promise<void> {
  current?.abort();
  const abort = new AbortController();
  current = abort;
  status.textContent = "opening …";
  statistics = { state: "opening", splats: 0, totalSplats: 0, frames: 0, upToDate: false };
  const service = inWorkers ? { service: (index: DecoderIndex) => new DecoderPool(index) } : {};
  const scene = await StreamedScene.open(source, { signal: abort.signal, ...service });
  const { info } = scene;
  const renderer = new SplatRenderer(canvas, info, info.shDegree);
  const camera = new OrbitCamera(info);
  let dirty = true;
  const change = (): void => {
    dirty = true;
    note({ upToDate: false });
  };
  poseChanged = () => {
    if (pose !== undefined) camera.place(pose);
    change();
  };
  poseChanged();
  note({ state: "streaming", totalSplats: info.splats });
  control(camera, abort.signal, change);
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
      note({ frames: statistics.frames + 1, upToDate: true });
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
    change();
    note({ splats: rows });
    status.textContent = `${rows.toLocaleString()} of ${info.splats.toLocaleString()} splats`;
  }
  status.textContent = `${info.splats.toLocaleString()} splats`;
  note({ state: "complete" });
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
  const message = error instanceof Error ? error.message : String(error);
  status.textContent = message;
  note({ state: "failed", error: message });
}

/** The file that the page holds, put together from its blocks; they are removed, so that it is in memory once. */
function heldScene(): Blob | undefined {
  const blocks = [...document.querySelectorAll(SCENE_BLOCKS)];
  if (blocks.length === 0) return undefined;
  const parts = blocks.map((block) => {
    const text = atob(block.textContent!);
    block.remove();
    return Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  });
  return new Blob(parts);
}

const held = heldScene();
document.addEventListener("dragover", (event) => event.preventDefault());
document.addEventListener("drop", (event) => {
  event.preventDefault();
  const file = event.dataTransfer?.files[0];
  if (file) show(file, held === undefined).catch(report);
});
const named = new URLSearchParams(location.search).get("scene") ?? document.documentElement.dataset["scene"];
if (held !== undefined) show(held, false).catch(report);
else if (named !== undefined) show(new URL(named, location.href).href).catch(report);
else status.textContent = "Drop a .cogs file here, or open this page with ?scene=URL.";
