import assert from "node:assert/strict";
import { test } from "node:test";
import { millisecondsLeft } from "../src/viewer/arrival_forecast.js";
import { PicturePace } from "../src/viewer/picture_pace.js";

/** Fake graphics that finish their commands when the test says so. */
class Graphics {
  readonly SYNC_GPU_COMMANDS_COMPLETE = 1;
  readonly TIMEOUT_EXPIRED = 2;
  readonly CONDITION_SATISFIED = 3;
  private readonly finished = new Set<object>();
  private readonly given: object[] = [];

  fenceSync(): object {
    const sync = {};
    this.given.push(sync);
    return sync;
  }

  clientWaitSync(sync: object): number {
    return this.finished.has(sync) ? this.CONDITION_SATISFIED : this.TIMEOUT_EXPIRED;
  }

  finish(): void {
    this.finished.add(this.given.shift()!);
  }

  flush(): void {
    // Commands are counted, not drawn.
  }

  deleteSync(sync: object): void {
    assert.ok(this.finished.delete(sync), "a fence is given back once");
  }
}

function started(): { readonly graphics: Graphics; readonly pace: PicturePace } {
  const graphics = new Graphics();
  return { graphics, pace: new PicturePace(graphics as unknown as WebGL2RenderingContext) };
}

/** Have a picture take some ms. */
function take(graphics: Graphics, pace: PicturePace, milliseconds: number, scale: number): void {
  pace.submitted(performance.now() - milliseconds, { scale, splats: 1000 });
  graphics.finish();
  assert.ok(pace.isIdle);
}

test("no picture is begun while slow graphics work on one", () => {
  const { graphics, pace } = started();
  take(graphics, pace, 500, 1);
  assert.ok(pace.isSlow && pace.isFree);
  pace.submitted(performance.now(), { scale: 1, splats: 1000 });
  assert.ok(!pace.isFree && !pace.isIdle);
  graphics.finish();
  assert.ok(pace.isFree && pace.isIdle);
});

test("quick graphics have one picture in reserve", () => {
  const { graphics, pace } = started();
  take(graphics, pace, 5, 1);
  assert.ok(!pace.isSlow);
  pace.submitted(performance.now(), { scale: 1, splats: 1000 });
  assert.ok(pace.isFree);
  pace.submitted(performance.now(), { scale: 1, splats: 1000 });
  assert.ok(!pace.isFree);
  pace.forget();
  assert.ok(pace.isFree);
});

test("pictures in haste have as many pixels as there is time for, and grow slowly", () => {
  const { graphics, pace } = started();
  assert.ok(pace.scale < 0.5, "how quick the graphics are is not known at first");
  const first = pace.scale;
  take(graphics, pace, 1, first);
  assert.ok(pace.scale > first && pace.scale <= 1.5 * first + 0.05);
  for (let i = 0; i < 5; i++) take(graphics, pace, 5, pace.scale);
  assert.equal(pace.scale, 1);
  take(graphics, pace, 90, 1);
  assert.ok(Math.abs(pace.scale - Math.SQRT1_2) < 0.03, `${pace.scale}`);
  take(graphics, pace, 5000, 1);
  assert.equal(pace.scale, first);
});

test("uploads keep the graphics busy and say nothing of pictures", () => {
  const { graphics, pace } = started();
  take(graphics, pace, 60, 1);
  const { milliseconds, scale } = pace;
  pace.uploads();
  assert.ok(!pace.isFree);
  graphics.finish();
  assert.ok(pace.isFree);
  assert.deepEqual([pace.milliseconds, pace.scale], [milliseconds, scale]);
});

test("more splats are expected to take longer, up to ten times", () => {
  const { graphics, pace } = started();
  pace.splats = 1000;
  assert.ok(pace.isSlow, "nothing is known yet");
  take(graphics, pace, 20, 1);
  const { milliseconds } = pace;
  assert.ok(!pace.isSlow);
  for (const [splats, longer] of [
    [10, 1],
    [1500, 1.5],
    [4000, 4],
    [1e6, 10],
  ] as const) {
    pace.splats = splats;
    assert.equal(pace.expected, longer * milliseconds);
  }
  assert.ok(pace.isSlow, "a picture of so many is not begun lightly");
});

test("the rest is expected to come as fast as what has come, bytes and splats", () => {
  const half = { splats: 50, totalSplats: 100, bytes: 500, totalBytes: 1000 };
  assert.equal(millisecondsLeft(half, 200), 200);
  assert.equal(millisecondsLeft({ ...half, bytes: 1000 }, 200), 200, "splats are still to be decoded");
  assert.equal(millisecondsLeft({ ...half, splats: 100 }, 300), 300, "bands are still to come");
  assert.equal(millisecondsLeft(half, 4000), 4000, "a link that stands still is not waited for");
  assert.equal(millisecondsLeft({ ...half, splats: 100, bytes: 1010 }, 200), 0);
  for (const unknown of [{ splats: 0 }, { bytes: 0 }, { totalBytes: undefined }]) {
    assert.equal(millisecondsLeft({ ...half, ...unknown }, 200), Infinity);
  }
});
