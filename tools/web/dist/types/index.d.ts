/**
 * COGS, Cloud-Optimized Gaussian Splats: open, stream and decode scenes in browsers and Node.
 *
 * @packageDocumentation
 */
export type { AttributeArray } from "./container/attributes.js";
export { equivalentPrefixes, isClosed, parentsOf } from "./container/chunk_sets.js";
export type { Shifts } from "./container/compensation.js";
export type { Camera } from "./container/cameras.js";
export type { Pinhole } from "./container/pinhole.js";
export type { AttributeEntry, CodebookEntry, SceneInfo } from "./container/root.js";
export type { ViewTable } from "./container/view_table.js";
export type { ByteRange, ChunkSegments, SceneIndex, ScenePlaces } from "./container/scene_index.js";
export { CogsplatError, REASON_CODES, SourceError, type ReasonCode, type RefusalClass } from "./errors.js";
export { JavascriptKernels } from "./kernels/javascript.js";
export type { Kernels } from "./kernels/kernels.js";
export { loadKernels, type KernelsMaker } from "./kernels/load.js";
export { BlobSource, type Answer, type ByteSource, type ReadOptions } from "./loader/byte_source.js";
export { HttpSource, type HttpOptions } from "./loader/http_source.js";
export type { RetryOptions } from "./loader/retry.js";
export { StreamedScene, type FolderReader, type OpenOptions } from "./loader/streamed_scene.js";
export type { ChunkInfo, ChunkUpdate, StreamOptions } from "./loader/stream_options.js";
export type { DecoderIndex } from "./scene/chunk_decoder.js";
export { DEFAULT_RANGES, packedMeans, SH_WORDS, shiftPacked, unpackSplats, type PackedSplats, type PackRanges } from "./scene/packed_splats.js";
export { PrefixCompensation } from "./scene/prefix_compensation.js";
export { SceneFile, type FileOptions } from "./scene/scene_file.js";
export { concatenate, type Splats } from "./scene/splats.js";
export { makeTexelArrays, texelWidths, writeTexels, type TexelArray, type TexelLayout, type Texels, type TexelWidth } from "./scene/texels.js";
export { InlineService, type ChunkFormat, type ChunkService, type DecodedChunk, type DecodeTask } from "./workers/decode_task.js";
export { DecoderPool, type PoolOptions, type WorkerLike } from "./workers/decoder_pool.js";
export { axesMatrix, axesRotation } from "./adapters/axes.js";
export { toPly, type PlyOptions } from "./adapters/ply.js";
