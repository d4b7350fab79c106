import assert from "node:assert/strict";
import { test } from "node:test";
import { cameraUniforms } from "../src/viewer/shader_rows.js";

const f = Math.fround;

/** Return the place of a mean in the picture as the shader computes it, every step rounded to float32. */
function placeInFloat32(
  mean: readonly number[],
  rotation: readonly number[],
  { cameraPosition, translation }: ReturnType<typeof cameraUniforms>,
  focal: number,
): [number, number] {
  const away = mean.map((value, axis) => f(f(value) - f(cameraPosition[axis]!)));
  const row = (i: number): number =>
    f([0, 1, 2].reduce((sum, axis) => f(sum + f(f(rotation[3 * i + axis]!) * away[axis]!)), 0) + f(translation[i]!));
  return [f(f(f(focal) * row(0)) / row(2)), f(f(f(focal) * row(1)) / row(2))];
}

test("10 km from the origin the shader places splats within a tenth of a pixel", () => {
  const [focal, cos, sin] = [1000, Math.cos(0.7), Math.sin(0.7)];
  const rotation = [cos, 0, sin, 0, 1, 0, -sin, 0, cos];
  for (const far of [0, 100, 10_000]) {
    const position = [far + 0.1371, -0.2113, -far + 0.0517];
    const onto = (v: readonly number[]) =>
      [0, 1, 2].map((i) => v.reduce((sum, x, axis) => sum + rotation[3 * i + axis]! * x, 0));
    const uniforms = cameraUniforms(
      rotation,
      onto(position).map((value) => -value),
      position,
    );
    let worst = 0;
    for (let i = 1; i <= 2000; i++) {
      const away = [1, 2, 3].map((k) => 4 * Math.sin(i * 12.9898 * k));
      // A float32 mean; the reference is exact from there on.
      const mean = away.map((value, axis) => f(value + position[axis]!));
      const [x, y, z] = onto(mean.map((value, axis) => value - position[axis]!)) as [number, number, number];
      if (z < 0.2) continue;
      const [u, v] = placeInFloat32(mean, rotation, uniforms, focal);
      worst = Math.max(worst, Math.hypot(u - (focal * x) / z, v - (focal * y) / z));
    }
    assert.ok(worst < 0.1, `${worst} px, ${far} units from the origin`);
  }
});
