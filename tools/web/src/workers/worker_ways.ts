import { WASM_DIGITS } from "../kernels/wasm_bytes.js";
import { startsText, TEXT_ADDRESS, type WorkerWay } from "./worker_start.js";

/** Program of `worker.js` without its kernels; the bundle defines it (`scripts/bundle.mjs`), sources lack it. */
declare const DECODER_TEXT: string | undefined;

/**
 * Return the ways to start decoding workers without any setting of a bundler.
 *
 * The text in this module works in every bundler. A policy `worker-src 'self'` refuses the text, but allows `worker.js`.
 * Vite and webpack find `worker.js` by the form of the call; otherwise it must be in the folder of this module.
 */
export function decoderWays(): WorkerWay[] {
  if (typeof Worker === "undefined") return [];
  const ways: WorkerWay[] = [];
  if (typeof DECODER_TEXT === "string")
    ways.push({ address: TEXT_ADDRESS, start: startsText(decoderText(DECODER_TEXT)) });
  ways.push({
    address: fileAddress(),
    start: () => new Worker(new URL("./worker.js", import.meta.url), { type: "module" }),
  });
  return ways;
}

/** Return the whole program of a decoding worker with the kernels of this module. */
export function decoderText(program: string): string {
  return `self.cogsplatKernels="${WASM_DIGITS}";${program}`;
}

/** Return the expected place of `worker.js` for messages; a bundler may have replaced this module's address. */
export function fileAddress(): string {
  return `worker.js beside ${import.meta.url.startsWith("http") ? import.meta.url : location.href}`;
}
