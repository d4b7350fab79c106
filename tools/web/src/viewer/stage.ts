import type { Description } from "../container/description.js";
import type { Vector } from "./orbit.js";
import type { SceneView } from "./scene_view.js";
import type { ViewerPose } from "./viewer_handle.js";

/** Parts of a viewer that its extras use: scene, elements of the page, messages. */
export interface Stage {
  readonly host: HTMLElement;
  /** Root element of the markup, with the classes of states. */
  readonly root: HTMLElement;
  readonly canvas: HTMLCanvasElement;
  /** Layer over the canvas for elements at places of the scene. */
  readonly overlay: HTMLElement;
  /** Row of the tools; panels stand in the column above it. */
  readonly foot: HTMLElement;
  readonly tools: HTMLElement;
  readonly scene: SceneView;
  /** Show a short text over the picture. */
  hint(text: string): void;
  /** Close the settings and all other panels. */
  closePanels(): void;
  /** Description of the scene; undefined where it has none. */
  description(): Description | undefined;
  /** Show the texts of another description. */
  describe(description: Description): void;
  /** Return the point of the scene at a place of the canvas, px; undefined where nothing is. */
  pick(x: number, y: number): Vector | undefined;
  /** Return the projection of the present pose; undefined before a scene is open. */
  projection(): Projection | undefined;
  /** Fly to a pose. */
  flyTo(pose: ViewerPose): void;
}

/** Projection of points of the scene into a picture. */
export interface Projection {
  /** Size of the canvas, CSS pixels. */
  readonly width: number;
  readonly height: number;
  /** Return the place of a point on the canvas, CSS pixels; undefined behind the camera. */
  place(point: readonly number[]): [number, number] | undefined;
}

/** Return the projection of a pose onto a canvas of a size in CSS pixels. */
export function projectionOf(pose: ViewerPose, width: number, height: number): Projection {
  const { rotation: r, translation: t, fx, fy } = pose;
  const scale = height / pose.height;
  return {
    width,
    height,
    place: (point) => {
      const [x, y, z] = [0, 3, 6].map((row, i) => point.reduce((sum, value, k) => sum + r[row + k]! * value, t[i]!));
      if (z! <= 0) return undefined;
      return [width / 2 + (scale * fx * x!) / z!, height / 2 + (scale * fy * y!) / z!];
    },
  };
}
