/**
 * COGS, Cloud-Optimized Gaussian Splats: open, stream and decode scenes in browsers and Node.
 *
 * @packageDocumentation
 */

// biome-ignore-all assist/source/organizeImports: The bundle has the modules in this order. The pool holds the program of
// its workers as a text, behind the same code in the module: gzip finds what repeats within 32 KiB.
export { type KernelsMaker, loadKernels } from "./kernels/load.js";
export {
  type ChunkFormat,
  type ChunkService,
  type DecodedChunk,
  type DecodeTask,
  InlineService,
} from "./workers/decode_task.js";
export { DecoderPool, type PoolOptions } from "./workers/decoder_pool.js";
export { axesMatrix, axesRotation } from "./adapters/axes.js";
export { type PlyOptions, toPly } from "./adapters/ply.js";
export type { AttributeArray } from "./container/attributes.js";
export type { Camera } from "./container/cameras.js";
export { isClosed, type SetState, setStates } from "./container/chunk_sets.js";
export type { Shifts } from "./container/compensation.js";
export type {
  Annotation,
  CameraPath,
  Description,
  Georeference,
  LengthUnit,
  NamedView,
  PathStop,
  PictureInfo,
  PictureName,
} from "./container/description.js";
export type { Pinhole } from "./container/pinhole.js";
export type { AttributeEntry, CodebookEntry, SceneInfo, Viewpoint } from "./container/root.js";
export type { ByteRange, ChunkSegments, Index, Page, SceneIndex, ScenePlaces } from "./container/scene_index.js";
export type { SceneRows } from "./container/scene_rows.js";
export type { ViewTable } from "./container/view_table.js";
export { CogsplatError, REASON_CODES, type ReasonCode, type RefusalClass, SourceError } from "./errors.js";
export type { Kernels } from "./kernels/kernels.js";
export { type Answer, BlobSource, type ByteSource, type ReadOptions } from "./loader/byte_source.js";
export { type HttpOptions, HttpSource } from "./loader/http_source.js";
export type { RetryOptions } from "./loader/retry.js";
export type { ChunkInfo, ChunkUpdate, StreamOptions } from "./loader/stream_options.js";
export { type FolderReader, type OpenOptions, StreamedScene } from "./loader/streamed_scene.js";
export type { DecoderIndex } from "./scene/chunk_decoder.js";
export {
  DEFAULT_RANGES,
  type PackedSplats,
  type PackRanges,
  SH_WORDS,
  shiftPacked,
  unpackSplats,
} from "./scene/packed_splats.js";
export { PrefixCompensation } from "./scene/prefix_compensation.js";
export { type FileOptions, SceneFile } from "./scene/scene_file.js";
export { concatenate, type Splats } from "./scene/splats.js";
export { trainingPixel } from "./scene/training_pixel.js";
export type { WorkerLike } from "./workers/worker_start.js";
