import { createHash } from "node:crypto";
import { readdirSync, readFileSync } from "node:fs";
import { join, relative } from "node:path";
import type { Camera } from "../src/container/cameras.js";

/** The conformance files, found from the folder that the tests run in, the package's. */
const FOLDER = join(process.cwd(), "..", "..", "tests", "vectors");

/** A file to decode, as `manifest.json` has it. */
export interface ValidVector {
  readonly name: string;
  readonly splats: number;
  readonly sh_degree: number;
  readonly chunk_splats: readonly number[];
  readonly arrays_sha256: string;
  readonly coarse_sha256?: string;
  readonly prefixes: readonly (readonly [number, number, readonly number[], readonly number[]])[];
  readonly until?: readonly number[];
  readonly levels?: readonly (readonly [number, number, string])[];
  readonly drawn?: readonly string[];
  readonly attributes?: readonly (readonly [string, string, number])[];
  readonly attribute_chunks?: readonly (readonly [number, readonly string[]])[];
  readonly compensated?: readonly (readonly [number, string])[];
  readonly compensated_sets?: readonly (readonly [readonly number[], string])[];
  readonly cameras?: readonly Camera[];
  /** Map of the description, with the keys of SPEC 5.13. */
  readonly description?: Readonly<Record<string, unknown>>;
  /** Media type, width, height and SHA-256 of each picture, by name. */
  readonly pictures?: Readonly<Partial<Record<"poster" | "sky", readonly [string, number, number, string]>>>;
  /** Page rows on the way to each index with a view table, and position and shares of each of its viewpoints. */
  readonly view_tables?: readonly (readonly [
    readonly number[],
    readonly (readonly [readonly number[], readonly number[]])[],
  ])[];
}

/** A file to refuse, as `manifest.json` has it. */
export interface InvalidVector {
  readonly name: string;
  readonly code: string;
  readonly stage: "open" | "decode" | "verify";
  readonly partial: boolean;
}

export const manifest = JSON.parse(readFileSync(join(FOLDER, "manifest.json"), "utf8")) as {
  readonly format: string;
  readonly valid: readonly ValidVector[];
  readonly invalid: readonly InvalidVector[];
  /** Names of manifests with the files that they stand for. */
  readonly folders: readonly { readonly name: string; readonly manifests: Readonly<Record<string, string>> }[];
  readonly invalid_folders: readonly InvalidVector[];
};

/** Read the files of a folder of the conformance files, by path. */
export function vectorFolder(kind: "folders" | "invalid-folders", name: string): Map<string, Uint8Array> {
  const folder = join(FOLDER, kind, name);
  const files = readdirSync(folder, { recursive: true, withFileTypes: true }).filter((entry) => entry.isFile());
  return new Map(
    files.map((entry) => {
      const path = join(entry.parentPath, entry.name);
      return [relative(folder, path).replaceAll("\\", "/"), new Uint8Array(readFileSync(path))];
    }),
  );
}

/** The bytes of a conformance file. */
export function vectorBytes(folder: "valid" | "invalid", name: string): Uint8Array {
  return new Uint8Array(readFileSync(join(FOLDER, folder, `${name}.cogs`)));
}

/** Return the SHA-256 of concatenated arrays in hexadecimal. */
export function sha256(...arrays: ArrayBufferView[]): string {
  const hash = createHash("sha256");
  for (const array of arrays) hash.update(new Uint8Array(array.buffer, array.byteOffset, array.byteLength));
  return hash.digest("hex");
}
