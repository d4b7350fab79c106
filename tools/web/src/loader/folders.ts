import { FolderIndex } from "../container/folder_index.js";
import { FolderSource } from "./folder_source.js";
import type { FolderReader } from "./streamed_scene.js";

/**
 * Reader of scenes stored as a folder of a manifest and objects (SPEC 3.4).
 *
 * @example
 * ```ts
 * import { StreamedScene } from "cogsplat";
 * import { folders } from "cogsplat/folders";
 *
 * const scene = await StreamedScene.open("https://example.org/garden/", { folders });
 * ```
 */
export const folders: FolderReader = {
  open(manifest, { available, length, hasRanges }, index) {
    const places = new FolderIndex(index, available);
    if (length !== undefined) places.checkLength(length);
    return { places, source: new FolderSource(manifest, places, hasRanges) };
  },
};
