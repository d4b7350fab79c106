// Program of viewer.html and of every page with a <cogsplat-viewer>. On the viewer's own page it shows the scene of
// `viewer.html?scene=URL`, the scene that the page names, or the one that it contains.
import { CogsplatViewer, defineViewer } from "./element.js";
import { extrasOfText } from "./extras_text.js";
import { render } from "./notebook.js";
import { workersOfTexts } from "./viewer_workers.js";

/** Blocks of a page that contains its scene: parts of the file's bytes in base64. */
const SCENE_BLOCKS = 'script[type="application/x-cogs-base64"]';
/** Blocks of a page that contains its workers' programs: the decoder's and the viewer's. */
const WORKER_BLOCKS = 'script[type="application/x-cogs-worker"]';

/** Block of a page that contains the program of the viewer's extras. */
const EXTRAS_BLOCK = 'script[type="application/x-cogs-extras"]';

/** Join the file from the blocks of the page, and remove the blocks, so that it is in memory once. */
function embeddedScene(): Blob | undefined {
  const blocks = [...document.querySelectorAll(SCENE_BLOCKS)];
  if (blocks.length === 0) return undefined;
  const parts = blocks.map((block) => {
    const text = atob(block.textContent!);
    block.remove();
    return Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  });
  return new Blob(parts);
}

/** Pass keys without a focused element to a viewer, so that it reacts before it was clicked. */
function passKeysTo(viewer: CogsplatViewer): void {
  document.addEventListener("keydown", (event) => {
    if (event.target !== document.body || event.key === "Tab") return;
    const canvas = viewer.shadowRoot!.querySelector("canvas")!;
    canvas.focus();
    const passed = new KeyboardEvent("keydown", event);
    if (!canvas.dispatchEvent(passed)) event.preventDefault();
  });
}

const extras = document.querySelector(EXTRAS_BLOCK)?.textContent;
if (extras != null) CogsplatViewer.loadExtras = () => extrasOfText(extras);
const [decoder, viewer] = [...document.querySelectorAll(WORKER_BLOCKS)].map((block) => block.textContent!);
if (decoder !== undefined && viewer !== undefined) CogsplatViewer.workers = workersOfTexts(decoder, viewer);
defineViewer();

const own = document.querySelector<CogsplatViewer>("main > cogsplat-viewer#page");
if (own !== null) {
  window.cogsplatViewer = own;
  passKeysTo(own);
  const held = embeddedScene();
  const wanted = new URLSearchParams(location.search);
  const against = wanted.get("against");
  const scene = wanted.get("scene");
  if (held !== undefined) void own.load(held);
  else {
    if (against !== null) own.setAttribute("against", against);
    if (scene !== null) own.setAttribute("src", scene);
  }
}

// Entry point of anywidget in notebooks.
export default { render };
