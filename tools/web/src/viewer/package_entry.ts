/**
 * The element `<cogsplat-viewer>` for pages made with a bundler: the entry point `cogsplat/viewer`.
 *
 * Importing it defines the element. On a server, where there are no elements, it does nothing.
 *
 * @packageDocumentation
 */
import { decoderText, fileAddress } from "../workers/worker_ways.js";
import { CogsplatViewer, defineViewer } from "./element.js";
import { workersOfTexts } from "./viewer_workers.js";

export type { SceneSource } from "./shown_scene.js";
export type { ViewerHandle, ViewerPose, ViewerStatistics } from "./viewer_handle.js";
export { CogsplatViewer, defineViewer };

/** Programs of the workers, which the bundle defines (`scripts/bundle.mjs`). */
declare const DECODER_TEXT: string;
declare const VIEWER_TEXT: string;

// Vite and webpack find the files by the form of the calls.
CogsplatViewer.workers = {
  ...workersOfTexts(decoderText(DECODER_TEXT), VIEWER_TEXT),
  otherwise: {
    get address() {
      return fileAddress();
    },
    start: () => new Worker(new URL("./worker.js", import.meta.url), { type: "module" }),
    viewer: () => new Worker(new URL("./viewer_worker.js", import.meta.url), { type: "module" }),
  },
};
if (typeof customElements !== "undefined") defineViewer();
