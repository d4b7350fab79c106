// Poses of cameras, from the views of COGS to renderers whose y points up and whose cameras look along −z.
import { axesMatrix } from "cogsplat";

/**
 * A view of SPEC 4.4 (world to camera, x right, y down, z forward) as a pose in the renderer's world.
 *
 * @param view - `height`, `fy`, `rotation` row by row and `translation`.
 * @param axes - The scene's axes, `scene.info.axes`.
 */
export function poseOf({ height, fy, rotation, translation }, axes) {
  const matrix = axesMatrix(axes);
  const turned = (v) => [0, 1, 2].map((row) => v.reduce((sum, value, i) => sum + matrix[3 * row + i] * value, 0));
  const row = (i, sign) => turned(Array.from(rotation.slice(3 * i, 3 * i + 3), (value) => sign * value));
  const centre = [0, 1, 2].map((i) => -[0, 1, 2].reduce((sum, j) => sum + rotation[3 * j + i] * translation[j], 0));
  return {
    position: turned(centre),
    right: row(0, 1),
    up: row(1, -1),
    back: row(2, -1),
    fieldOfView: 2 * Math.atan(height / (2 * fy)),
  };
}

/** Return the first pose: the scene's first view, or one at which its bounding box fits into the picture. */
export function firstPose(info, fieldOfView) {
  if (info.firstView !== undefined) return poseOf(info.firstView, info.axes);
  const { box } = info;
  const centre = [0, 1, 2].map((i) => (box[i] + box[i + 3]) / 2);
  const radius = Math.hypot(...[0, 1, 2].map((i) => box[i + 3] - box[i])) / 2;
  const matrix = axesMatrix(info.axes);
  const position = [0, 1, 2].map((row) => centre.reduce((sum, value, i) => sum + matrix[3 * row + i] * value, 0));
  position[2] += radius / Math.tan(fieldOfView / 2);
  return { position, right: [1, 0, 0], up: [0, 1, 0], back: [0, 0, 1], fieldOfView };
}
