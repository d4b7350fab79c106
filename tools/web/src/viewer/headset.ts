import type { EyeTarget, View } from "./renderer.js";
import type { SceneView } from "./scene_view.js";
import { add, cross, dot, rotate, scaled, type Vector } from "./vectors.js";
import type { ViewerPose } from "./viewer_handle.js";

/** Distance of the target in a scene whose scale is unknown, m. */
const TARGET_METRES = 2;
/** Speed at a full deflection of a thumbstick, m/s. */
const SPEED = 1.5;
/** Turn at a deflection of a thumbstick to the side, radians: at once, because slow turns make people dizzy. */
const TURN = Math.PI / 6;
/** Deflections below this share are none. */
const DEAD_ZONE = 0.2;
/** Deflection at which a turn begins. */
const TURNING = 0.7;

/** Matrix of WebXR: 16 numbers, column by column. */
type Matrix = ArrayLike<number>;

/** Parts of WebXR (w3.org/TR/webxr) that are used here, for which TypeScript has no types. */
interface XrPose {
  readonly transform: { readonly matrix: Matrix };
  readonly views: readonly {
    readonly projectionMatrix: Matrix;
    readonly transform: { readonly matrix: Matrix };
  }[];
}

interface XrLayer {
  readonly framebuffer: WebGLFramebuffer | null;
  getViewport(view: XrPose["views"][number]): Pick<EyeTarget, "x" | "y" | "width" | "height">;
}

interface XrFrame {
  getViewerPose(space: object): XrPose | null | undefined;
}

interface XrSession extends EventTarget {
  readonly inputSources: Iterable<{ readonly handedness: string; readonly gamepad?: Pick<Gamepad, "axes"> | null }>;
  updateRenderState(state: { baseLayer: XrLayer }): void;
  requestReferenceSpace(type: "local"): Promise<object>;
  requestAnimationFrame(draw: (time: number, frame: XrFrame) => void): number;
  end(): Promise<void>;
}

interface XrBrowser {
  readonly navigator: { readonly xr: { requestSession(mode: "immersive-vr"): Promise<XrSession> } };
  readonly XRWebGLLayer: new (session: XrSession, gl: WebGL2RenderingContext) => XrLayer;
}

/** Origin, axes and scale of the headset's space in the space of the means. */
interface Placement {
  /** Origin of the headset's space. */
  origin: Vector;
  /** Right, up and back of the headset's space. */
  axes: readonly [Vector, Vector, Vector];
  /** Scene units per metre. */
  readonly scale: number;
}

/** Shows a scene in a headset, from the pose of the canvas, until the session ends. */
export class Headset {
  private readonly stopPresenting: () => void;
  private lastTime: number | undefined;
  private hasTurned = false;

  private constructor(
    private readonly scene: SceneView,
    private readonly session: XrSession,
    private readonly layer: XrLayer,
    private readonly space: object,
    private readonly placement: Placement,
    ended: () => void,
  ) {
    this.stopPresenting = scene.present();
    session.addEventListener("end", () => {
      this.stopPresenting();
      ended();
    });
    session.requestAnimationFrame(this.draw);
  }

  /**
   * Begin, within a person's click.
   *
   * @param metresPerUnit - Metres of a scene unit; undefined where they are not known.
   * @param ended - Called when the session has ended.
   */
  static async begin(scene: SceneView, metresPerUnit: number | undefined, ended: () => void): Promise<Headset> {
    const browser = globalThis as unknown as XrBrowser;
    const session = await browser.navigator.xr.requestSession("immersive-vr");
    try {
      const { gl } = scene;
      await (gl as unknown as { makeXRCompatible(): Promise<void> }).makeXRCompatible();
      const layer = new browser.XRWebGLLayer(session, gl);
      session.updateRenderState({ baseLayer: layer });
      const space = await session.requestReferenceSpace("local");
      const { pose, up } = scene.camera;
      if (pose === undefined || up === undefined) throw new Error("no scene is open");
      return new Headset(scene, session, layer, space, placementOf(pose, up, metresPerUnit), ended);
    } catch (error) {
      await session.end();
      throw error;
    }
  }

  end(): void {
    void this.session.end();
  }

  private readonly draw = (time: number, frame: XrFrame): void => {
    const { session, layer, placement, scene } = this;
    session.requestAnimationFrame(this.draw);
    const pose = frame.getViewerPose(this.space);
    if (pose == null) return;
    const { matrix } = pose.transform;
    this.steer(matrix, Math.min((time - (this.lastTime ?? time)) / 1000, 0.1));
    this.lastTime = time;
    const head = poseOf(matrix, placement);
    const forward = head.rotation.slice(6, 9);
    const eyes = pose.views.map(({ transform, projectionMatrix: p }) => {
      const { x, y, width, height } = layer.getViewport({ transform, projectionMatrix: p });
      const view: View = {
        ...poseOf(transform.matrix, placement),
        focal: [(p[0]! * width) / 2, (p[5]! * height) / 2],
        principal: [(-p[8]! * width) / 2, (p[9]! * height) / 2],
      };
      return { view, target: { framebuffer: layer.framebuffer, x, y, width, height, forward } };
    });
    const [first] = eyes;
    if (first === undefined) return;
    const { width, height } = first.target;
    const [fx, fy] = first.view.focal;
    scene.drawEyes({ ...head, width, height, fx, fy }, eyes);
  };

  /** Move by the left thumbstick, turn and rise by the right one. */
  private steer(head: Matrix, seconds: number): void {
    const { placement } = this;
    const metres = SPEED * seconds * placement.scale;
    let turns = 0;
    for (const { handedness, gamepad } of this.session.inputSources) {
      const [x, y] = [gamepad?.axes[2] ?? 0, gamepad?.axes[3] ?? 0].map((share) =>
        Math.abs(share) < DEAD_ZONE ? 0 : share,
      ) as [number, number];
      const [, up] = placement.axes;
      if (handedness === "right") {
        if (Math.abs(x) > TURNING) turns = -Math.sign(x);
        placement.origin = add(placement.origin, up, -y * metres);
      } else {
        const right = levelRight(poseOf(head, placement).rotation, up);
        placement.origin = add(add(placement.origin, right, x * metres), cross(up, right), -y * metres);
      }
    }
    if (turns !== 0 && !this.hasTurned) this.turn(head, turns * TURN);
    this.hasTurned = turns !== 0;
  }

  /** Turn about the head. */
  private turn(head: Matrix, angle: number): void {
    const { placement } = this;
    const [, up] = placement.axes;
    const before = placeOf(head, placement);
    placement.axes = placement.axes.map((axis) => rotate(axis, up, angle)) as [Vector, Vector, Vector];
    placement.origin = add(placement.origin, add(before, placeOf(head, placement), -1), 1);
  }
}

/** Return the placement in which a headset starts: level, at the position and heading of a pose. */
function placementOf(view: ViewerPose, up: Vector, metresPerUnit: number | undefined): Placement {
  const { rotation: r, translation: t, target } = view;
  const origin = [0, 1, 2].map((i) => -(r[i]! * t[0]! + r[3 + i]! * t[1]! + r[6 + i]! * t[2]!)) as Vector;
  const right = levelRight(r, up);
  const far = target === undefined ? TARGET_METRES : Math.hypot(...target.map((value, i) => value - origin[i]!));
  const scale = metresPerUnit === undefined ? far / TARGET_METRES : 1 / metresPerUnit;
  return { origin, axes: [right, up, cross(right, up)], scale };
}

/** Return the level direction to the right of a camera. */
function levelRight(rotation: readonly number[], up: Vector): Vector {
  const [right, , front] = [0, 3, 6].map((i) => rotation.slice(i, i + 3)) as [Vector, Vector, Vector];
  const side = cross(front, up);
  // A camera that looks straight down or up has a level right side of its own.
  const level = Math.hypot(...side) > 1e-3 ? side : add(right, up, -dot(right, up));
  return scaled(level, 1 / Math.hypot(...level));
}

/** Convert a direction from the headset's space to the space of the means. */
function directionOf({ axes }: Placement, x: number, y: number, z: number): Vector {
  return add(add(scaled(axes[0], x), axes[1], y), axes[2], z);
}

/** Return the position of a matrix of the headset's space in the scene. */
function placeOf(m: Matrix, placement: Placement): Vector {
  return add(placement.origin, directionOf(placement, m[12]!, m[13]!, m[14]!), placement.scale);
}

/** Return the pose of a matrix of the headset's space: x right, y up, z back there; right, down, front here. */
function poseOf(m: Matrix, placement: Placement): Pick<View, "rotation" | "translation"> {
  const rows = [1, -1, -1].map((sign, i) =>
    scaled(directionOf(placement, m[4 * i]!, m[4 * i + 1]!, m[4 * i + 2]!), sign),
  );
  const place = placeOf(m, placement);
  return { rotation: rows.flat(), translation: rows.map((row) => -dot(row, place)) };
}
