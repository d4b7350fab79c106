import type { FolderIndex } from "../container/folder_index.js";
import type { SceneIndex } from "../container/scene_index.js";
import type { RetryingReader } from "./retrying_reader.js";
/**
 * The file that a folder stands for (SPEC 3.4).
 *
 * @param index - With all pages read.
 * @param manifest - Its beginning, preamble and root at least; pages that are in it are not asked for.
 */
export declare function packFolder(index: SceneIndex, places: FolderIndex, manifest: Uint8Array, reader: RetryingReader, signal: AbortSignal | undefined): Promise<Uint8Array>;
/** Refuse a folder of which an object has another name than its bytes have. */
export declare function checkObjects(places: FolderIndex, reader: RetryingReader, signal: AbortSignal | undefined): Promise<void>;
