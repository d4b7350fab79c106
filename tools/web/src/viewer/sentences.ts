import { CogsplatError, SourceError } from "../errors.js";
import { formatShare } from "./numbers.js";
import { NoWebGlError } from "./renderer.js";

/** A message to a person: a short title, and the cause or remedy. */
export interface Sentence {
  readonly title: string;
  readonly detail: string;
}

/**
 * Describe an error to a person.
 *
 * @param shown - Whether a part of the scene is visible.
 * @param address - URL of the scene, which the detail names.
 */
export function describeError(error: unknown, shown: boolean, address?: string): Sentence {
  const sentence = sentenceOf(error, shown);
  if (address === undefined || error instanceof NoWebGlError || sentence.detail.includes(address)) return sentence;
  return { ...sentence, detail: `${sentence.detail} Address: ${address}` };
}

function sentenceOf(error: unknown, shown: boolean): Sentence {
  if (error instanceof NoWebGlError) {
    return {
      title: "This browser cannot draw the scene",
      detail: "It has no WebGL 2, or its graphics are switched off. Another browser, or a newer one, will show it.",
    };
  }
  if (error instanceof SourceError) return ofSource(error);
  if (error instanceof CogsplatError) return ofFile(error, shown);
  const message = error instanceof Error ? error.message : String(error);
  return { title: "The scene cannot be shown", detail: message };
}

function ofSource({ status, message }: SourceError): Sentence {
  if (status === 404 || status === 410) {
    return {
      title: "There is no scene at this address",
      detail: `The server answered with status ${status}: the file was moved, or the address is wrong.`,
    };
  }
  if (status === 401 || status === 403) {
    return {
      title: "Access to this scene is denied",
      detail: `The server answered with status ${status}: access to the file needs permission.`,
    };
  }
  if (status !== undefined && status >= 400) {
    return {
      title: "The server failed",
      detail: `It answered with status ${status}. Trying again later may help.`,
    };
  }
  if (status === undefined) {
    return {
      title: "The scene cannot be reached",
      detail:
        "Either there is no connection, or the server of the file does not let pages of other sites read it (CORS).",
    };
  }
  return { title: "The server's answer cannot be used", detail: message };
}

function ofFile(error: CogsplatError, shown: boolean): Sentence {
  const { code, refusal, message } = error;
  if (code === "not-cogs") {
    return {
      title: "This file is not a scene",
      detail: "The file is neither a .cogs file nor a PLY of splats.",
    };
  }
  if (code === "source-changed") {
    return {
      title: "The scene was replaced",
      detail: "The file on the server changed while it was read. Load it again to see the new one.",
    };
  }
  if (refusal === "truncated") {
    const [, present, whole] = /^(\d+) of (\d+) bytes/.exec(error.detail) ?? [];
    const there = present === undefined ? message : `${formatShare(Number(present), Number(whole))} are there`;
    return {
      title: "The file ends early",
      detail: shown ? `${there} and shown; the rest is missing.` : `${there}, too little to show.`,
    };
  }
  if (refusal === "unsupported") {
    return {
      title: "This scene is newer than the viewer",
      detail: `It uses a feature that this version does not have. ${message}`,
    };
  }
  if (refusal === "limit") return { title: "This scene is too large to show", detail: message };
  return shown
    ? { title: "A part of the file is damaged", detail: `The undamaged part is shown. ${message}` }
    : { title: "The file is damaged", detail: message };
}

/** The browser has taken the graphics away, and will give them back. */
export const GRAPHICS_LOST: Sentence = {
  title: "The graphics were interrupted",
  detail: "The scene comes back as soon as the browser has them again.",
};

/** Return the hint for zooming by the wheel in a page that scrolls. */
export function wheelHint(): string {
  return `Click the scene, or hold ${/mac/i.test(navigator.userAgent) ? "⌘" : "Ctrl"}, to zoom with the wheel`;
}
