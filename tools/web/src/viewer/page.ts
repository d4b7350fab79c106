// The program of viewer.html, and of every page with a <cogsplat-viewer>. Where the page is the viewer's own, it shows
// `viewer.html?scene=URL`, the scene that the page names, or the one that it holds.
import { CogsplatViewer, defineViewer } from "./element.js";
import { render } from "./notebook.js";
import { workersOfTexts } from "./viewer_workers.js";

/** Blocks of a page that holds its scene: the file's bytes in base64, a part of them each. */
const SCENE_BLOCKS = 'script[type="application/x-cogs-base64"]';
/** Blocks of a page that holds the programs of its workers: the one that decodes, and the viewer's. */
const WORKER_BLOCKS = 'script[type="application/x-cogs-worker"]';

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

/** Give a viewer the keys that nothing else has: on a page of its own they are meant for it before it was clicked. */
function passKeysTo(viewer: CogsplatViewer): void {
  document.addEventListener("keydown", (event) => {
    if (event.target !== document.body || event.key === "Tab") return;
    const canvas = viewer.shadowRoot!.querySelector("canvas")!;
    canvas.focus();
    const passed = new KeyboardEvent("keydown", event);
    if (!canvas.dispatchEvent(passed)) event.preventDefault();
  });
}

const [decoder, viewer] = [...document.querySelectorAll(WORKER_BLOCKS)].map((block) => block.textContent!);
if (decoder !== undefined && viewer !== undefined) CogsplatViewer.workers = workersOfTexts(decoder, viewer);
defineViewer();

const own = document.querySelector<CogsplatViewer>("body > cogsplat-viewer#page");
if (own !== null) {
  window.cogsplatViewer = own;
  passKeysTo(own);
  const held = heldScene();
  const wanted = new URLSearchParams(location.search);
  const against = wanted.get("against");
  const scene = wanted.get("scene");
  if (held !== undefined) void own.load(held);
  else {
    if (against !== null) own.setAttribute("against", against);
    if (scene !== null) own.setAttribute("src", scene);
  }
}

// What anywidget calls in a notebook.
export default { render };
