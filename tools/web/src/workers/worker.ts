// Program of a decoder's worker: it decodes the chunks of one scene in the order of their tasks.
import { CogsplatError, type ReasonCode } from "../errors.js";
import { loadKernels } from "../kernels/load.js";
import { InlineService } from "./decode_task.js";
import { buffersOf, type Request, type Response } from "./messages.js";

/** The worker's side of the messages; `lib.webworker` conflicts with `lib.dom`. */
interface WorkerScope {
  onmessage: ((event: MessageEvent<Request>) => void) | null;
  postMessage(message: Response, transfer: ArrayBuffer[]): void;
}

const scope = globalThis as unknown as WorkerScope;
// Tells pages whose policy may refuse workers that this one runs.
scope.postMessage({ ready: true }, []);
/** Compiled while the first bytes of the scene arrive. */
const loading = loadKernels();
let service: Promise<InlineService> | undefined;
/** Error of a refused codebook, with which every later chunk is refused. */
let refusal: unknown;

scope.onmessage = ({ data }) => {
  if (data.type === "scene") {
    service = loading.then((kernels) => new InlineService(data.index, kernels));
  } else if (data.type === "codebook") {
    service!.then(
      (decoder) => {
        try {
          decoder.addCodebook(data.codebook, data.kind, data.payload);
        } catch (error) {
          refusal ??= error;
        }
      },
      () => undefined, // Every chunk is refused with the error of the kernels.
    );
  } else {
    const { id, task } = data;
    service!.then(
      (decoder) => {
        try {
          if (refusal !== undefined) throw refusal;
          const decoded = decoder.decodeNow(task);
          scope.postMessage({ id, decoded }, buffersOf(decoded));
        } catch (error) {
          scope.postMessage({ id, ...describe(error) }, []);
        }
      },
      (error: unknown) => scope.postMessage({ id, ...describe(error) }, []),
    );
  }
};

function describe(error: unknown): { code: ReasonCode | undefined; message: string; offset: number | undefined } {
  if (error instanceof CogsplatError) return { code: error.code, message: error.detail, offset: error.offset };
  return { code: undefined, message: error instanceof Error ? error.message : String(error), offset: undefined };
}
