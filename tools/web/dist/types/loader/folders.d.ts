import type { FolderReader } from "./streamed_scene.js";
/**
 * Reads scenes that are kept as folders of a manifest and objects (SPEC 3.4).
 *
 * @example
 * ```ts
 * import { StreamedScene } from "cogsplat";
 * import { folders } from "cogsplat/folders";
 *
 * const scene = await StreamedScene.open("https://example.org/garden/", { folders });
 * ```
 */
export declare const folders: FolderReader;
