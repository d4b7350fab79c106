import type { FolderIndex, FolderObject } from "../container/folder_index.js";
import type { ByteRange } from "../container/scene_index.js";
import { CogsplatError, SourceError } from "../errors.js";
import { type Answer, type ByteSource, type ReadOptions, readAll, readParts } from "./byte_source.js";

/** Maximum size of the whole objects kept from a server without ranges, bytes. */
const KEPT_BYTES = 32 * 2 ** 20;

/** The manifest and the objects of a folder as one source, with the addresses of `FolderIndex`. */
export class FolderSource implements ByteSource {
  /** Whole objects from a server without ranges, requested once for all their ranges. */
  private readonly kept = new Map<FolderObject, Promise<Uint8Array>>();

  constructor(
    private readonly manifest: ByteSource,
    private readonly index: FolderIndex,
    /** Whether the server answers range requests, as far as known. */
    private hasRanges: boolean,
  ) {
    if (manifest.relative === undefined)
      throw new SourceError("the manifest of a folder, expected its URL", undefined, false);
  }

  get mostRequests(): number | undefined {
    return this.manifest.mostRequests;
  }

  async read(range: ByteRange, options: ReadOptions = {}): Promise<Answer> {
    const { object, offset } = this.index.at(range.offset);
    if (this.hasRanges || options.fresh) {
      const answer = await this.request(object, { offset, length: range.length }, options);
      this.hasRanges &&= !answer.whole;
      return { ...answer, offset: range.offset - offset + answer.offset, total: undefined, whole: false };
    }
    const bytes = (await this.readWhole(object)).slice(offset);
    return {
      offset: range.offset,
      total: undefined,
      whole: false,
      parts: readParts(new Blob([bytes]).stream(), options.signal),
    };
  }

  private async request(object: FolderObject, range: ByteRange, options?: ReadOptions): Promise<Answer> {
    const { name, size } = object;
    const source = name === "" ? this.manifest : this.manifest.relative!(name);
    const answer = await source.read(range, options).catch((error: unknown) => {
      const isMissing = name !== "" && error instanceof SourceError && (error.status === 404 || error.status === 410);
      throw isMissing ? new CogsplatError("segment-missing", `${name} is missing`) : error;
    });
    if (answer.total === undefined || answer.total === size) return answer;
    await answer.parts[Symbol.asyncIterator]().return?.();
    throw new CogsplatError("segment-object", `${name} has ${answer.total} bytes, expected ${size}`);
  }

  /** Read a whole object from a server without ranges. */
  private readWhole(object: FolderObject): Promise<Uint8Array> {
    const known = this.kept.get(object);
    if (known !== undefined) return known;
    // Several callers may share the request, so no signal of one caller stops it.
    const bytes = readAll({ read: (range) => this.request(object, range) }, { offset: 0, length: object.size });
    this.kept.set(object, bytes);
    bytes.catch(() => this.kept.delete(object));
    let sum = 0;
    for (const other of [...this.kept.keys()].reverse()) {
      sum += other.size;
      if (sum > KEPT_BYTES && other !== object) this.kept.delete(other);
    }
    return bytes;
  }
}
