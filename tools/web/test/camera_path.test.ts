import assert from "node:assert/strict";
import { test } from "node:test";
import type { CameraPath, PathStop } from "../src/container/description.js";
import { PathPlayer, poseAt } from "../src/viewer/camera_path.js";
import { positionOf, translationOf } from "../src/viewer/flight.js";
import type { OrbitCamera, Vector } from "../src/viewer/orbit.js";
import type { ViewerPose } from "../src/viewer/viewer_handle.js";

/** A stop at a place, turned about y by an angle. */
function stop(time: number, place: readonly number[], angle: number, fx = 50): PathStop {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const rotation = [c, 0, -s, 0, 1, 0, s, 0, c];
  const size = { width: 100, height: 80, fx, fy: fx, cx: 50, cy: 40 };
  return { time, ...size, rotation, translation: translationOf(rotation, place) };
}

const PATH: CameraPath = {
  loop: false,
  stops: [stop(0, [0, 0, 0], 0), stop(1, [1, 0, 0], 0.5), stop(3, [3, 0, 0], 1, 80), stop(4, [3, 2, 0], 1)],
};

const near = (a: readonly number[], b: readonly number[]): boolean =>
  a.every((value, i) => Math.abs(value - b[i]!) < 1e-9);

test("a path passes its stops, and stays at its ends", () => {
  for (const { time, rotation, translation, fy, height } of PATH.stops) {
    const pose = poseAt(PATH, time);
    assert.ok(near(pose.rotation, rotation) && near(pose.translation, translation), String(time));
    assert.ok(Math.abs(pose.fy / pose.height - fy / height) < 1e-9);
  }
  assert.deepEqual(poseAt(PATH, 9).translation, PATH.stops[3]!.translation);
});

test("a path runs evenly along a straight part, and without a jump", () => {
  // Places grow by 1 a second between the first three stops.
  assert.ok(near(positionOf(poseAt(PATH, 0.5)), [0.5, 0, 0]));
  for (let time = 0; time < 4; time += 0.01) {
    const [a, b] = [poseAt(PATH, time), poseAt(PATH, time + 0.01)].map(positionOf) as [Vector, Vector];
    assert.ok(Math.hypot(...a.map((value, i) => value - b[i]!)) < 0.05);
  }
});

/** Play a path in steps, and return the poses set. */
function play(
  player: PathPlayer,
  seconds: readonly number[],
): { readonly poses: ViewerPose[]; readonly goesOn: boolean } {
  const poses: ViewerPose[] = [];
  const camera = { setPose: (pose: ViewerPose) => poses.push(pose) } as unknown as OrbitCamera;
  const motion = player.motion();
  const goesOn = seconds.map((step) => motion(camera, step)).at(-1)!;
  return { poses, goesOn };
}

test("a pause keeps the time, the end begins again, and a loop never ends", () => {
  const player = new PathPlayer(PATH);
  assert.ok(play(player, [0.5]).goesOn);
  const { poses, goesOn } = play(player, [0.5, 2, 5]);
  assert.ok(near(poses[0]!.translation, PATH.stops[1]!.translation));
  assert.equal(goesOn, false);
  assert.ok(near(play(player, [0]).poses[0]!.translation, PATH.stops[0]!.translation));
  const loop = play(new PathPlayer({ ...PATH, loop: true }), [3, 1.5]);
  assert.ok(loop.goesOn);
  assert.ok(near(positionOf(loop.poses[1]!), positionOf(poseAt(PATH, 0.5))));
});
