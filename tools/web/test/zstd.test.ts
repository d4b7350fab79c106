import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { crc32 } from "../src/container/crc32.js";
import { CogsplatError } from "../src/errors.js";
import type { Kernels } from "../src/kernels/kernels.js";
import { loadKernels } from "../src/kernels/load.js";
import { checkFrame } from "../src/streams/zstd_frame.js";

const MUTATIONS = 12;
const CANARY = 0xaa;

/** Frames by libzstd; `tests/tools/web/make_frames.py` says how they are made. */
const frames = readFrames(new Uint8Array(readFileSync(join(process.cwd(), "test", "frames.bin"))));

function readFrames(file: Uint8Array): { frame: Uint8Array; length: number; crc: number }[] {
  const view = new DataView(file.buffer, file.byteOffset, file.byteLength);
  const found = [];
  for (let at = 0; at < file.length; ) {
    const size = view.getUint32(at, true);
    found.push({
      frame: file.slice(at + 12, at + 12 + size),
      length: view.getUint32(at + 4, true),
      crc: view.getUint32(at + 8, true),
    });
    at += 12 + size;
  }
  return found;
}

/** Decompress behind a canary, and give the bytes where the kernel accepts the frame. */
function decompress(k: Kernels, frame: Uint8Array, length: number): Uint8Array | undefined {
  const mark = k.mark();
  const source = k.alloc(frame.length);
  k.u8.set(frame, source);
  const target = k.alloc(length);
  const canary = k.alloc(64);
  k.u8.fill(CANARY, canary, canary + 64);
  const status = k.zstd(source, frame.length, target, length);
  const bytes = k.u8.slice(target, target + length);
  assert.ok(
    k.u8.subarray(canary, canary + 64).every((byte) => byte === CANARY),
    "bytes behind the plane were written",
  );
  k.release(mark);
  return status === 0 ? bytes : undefined;
}

const makeKernels = await loadKernels();

test("every frame of libzstd gives its bytes", () => {
  const k = makeKernels();
  assert.ok(frames.length > 80);
  for (const { frame, length, crc } of frames) {
    checkFrame(frame, length, 0);
    const bytes = decompress(k, frame, length);
    assert.ok(bytes !== undefined, `a frame of ${frame.length} bytes was refused`);
    assert.equal(crc32(bytes), crc);
  }
});

test("a frame that gives another number of bytes is refused", () => {
  const k = makeKernels();
  for (const { frame, length } of frames) {
    assert.equal(decompress(k, frame, length + 1), undefined);
    if (length > 1) assert.equal(decompress(k, frame, length - 1), undefined);
  }
});

test("damaged frames are refused or give bytes, and write nowhere else", () => {
  const k = makeKernels();
  let state = 1;
  const next = (below: number) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * below);
  };
  let refused = 0;
  for (const { frame, length } of frames) {
    if (length > 5000) continue;
    for (let i = 0; i < MUTATIONS; i++) {
      const damaged = frame.slice();
      damaged[next(damaged.length)]! ^= 1 << next(8);
      try {
        checkFrame(damaged, length, 0);
      } catch (error) {
        assert.ok(error instanceof CogsplatError);
        refused++;
        continue;
      }
      if (decompress(k, damaged, length) === undefined) refused++;
    }
  }
  assert.ok(refused > frames.length, `${refused} were refused`);
});
