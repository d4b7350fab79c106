import type { SceneInfo } from "../container/root.js";
import type { PackedSplats } from "../scene/packed_splats.js";
import { bulkOf, depthAhead } from "./framing.js";
import { OrbitCamera, type OrbitScene, type Vector } from "./orbit.js";
import { poseOf, type ViewText } from "./view_text.js";
import type { ViewerPose } from "./viewer_handle.js";

/** Time without a change of the pose after which the camera rests, ms. */
const REST_MILLISECONDS = 200;

/** Moves the camera before each picture, given the s since the last one; false ends the motion, and so does a person. */
export type Motion = (camera: OrbitCamera, seconds: number) => boolean;

/** First pose of the camera, in place of the scene's first view. */
export interface Start {
  readonly view?: ViewText | undefined;
  readonly up?: Vector | undefined;
  /** Point that turning goes around. */
  readonly target?: Vector | undefined;
}

/** Functions of a scene view that its camera calls. */
export interface SceneCameraHost {
  /** Return width and height of the canvas, device pixels. */
  size(): readonly [number, number];
  /** Return whether a person is moving the camera. */
  isHeld(): boolean;
  /** Called when the pose may have changed. */
  redraw(): void;
  /** Called when the camera has come to rest in another pose. */
  rested(): void;
  /** Called when a motion has ended; by a person or by itself. */
  motionEnded(byPerson: boolean): void;
}

/** Camera of a canvas: its first pose in a scene, the motions that move it, and its rest. */
export class SceneCamera {
  /** Camera of the scene; undefined before a scene is open. */
  orbit: OrbitCamera | undefined;
  /** World position of the zero of poses. */
  origin: readonly number[] = [0, 0, 0];
  /** Whether the camera has been moved since it was at its first pose. */
  wasMoved = false;
  /** Makes a camera at the first view of the scene. */
  private makeOrbit: (() => OrbitCamera) | undefined;
  /** Moves a new camera to a position or target that the first rows show. */
  private frame: ((camera: OrbitCamera) => void) | undefined;
  private start: Start = {};
  /** Pose that was set last. */
  private chosen: ViewerPose | undefined;
  private motion: Motion | undefined;
  private isFree = false;
  private visible = true;
  /** Pose at the last call of `watchRest`, and the timer that reports the rest. */
  private seen = "";
  private resting: ReturnType<typeof setTimeout> | undefined;

  constructor(private readonly host: SceneCameraHost) {}

  /** Pose of the camera; before a scene is open the one that was set, which applies to later scenes too. */
  get pose(): ViewerPose | undefined {
    const { orbit } = this;
    if (orbit === undefined) return this.chosen;
    const [width, height] = this.host.size();
    const { rotation, translation, focal } = orbit.view(height, width);
    return { width, height, fx: focal[0], fy: focal[1], rotation, translation, target: orbit.target };
  }

  set pose(pose: ViewerPose | undefined) {
    this.endMotion(true);
    this.chosen = pose;
    if (pose !== undefined) this.orbit?.setPose(pose);
    this.host.redraw();
  }

  /** Text of the pose; undefined before a scene is open. */
  get text(): string | undefined {
    const [width, height] = this.host.size();
    return this.orbit?.text(height, width);
  }

  /** Direction against gravity; undefined before a scene is open. */
  get up(): Vector | undefined {
    return this.orbit?.up;
  }

  /** Focal length in a picture of the canvas's size, pixels; 1 before a scene is open. */
  get focal(): number {
    const [width, height] = this.host.size();
    return this.orbit?.view(height, width).focal[1] ?? 1;
  }

  /** Whether turning may go anywhere: over the poles and below the ground too. */
  set orbitsFreely(isFree: boolean) {
    this.isFree = isFree;
    if (this.orbit !== undefined) this.orbit.isFree = isFree;
  }

  /** Whether the canvas can be seen; motions wait until it is. */
  set isVisible(visible: boolean) {
    this.visible = visible;
    if (this.motion !== undefined) this.host.redraw();
  }

  /** Go to the first pose of a scene; `keepsPose` stays in the present pose. */
  enter(scene: OrbitScene & Pick<SceneInfo, "origin">, keepsPose: boolean): void {
    this.origin = scene.origin;
    this.makeOrbit = () => new OrbitCamera({ ...scene, ...(this.start.up && { up: this.start.up }) });
    this.frame = undefined;
    const pose = keepsPose ? this.pose : undefined;
    this.reset();
    if (pose === undefined) return;
    this.orbit!.setPose(pose);
    this.wasMoved = true;
  }

  /**
   * Choose position or target by the first rows of a scene that has no first view with a target.
   *
   * @param shift - Vector from means of the rows to points in the space of the poses.
   */
  frameRows(rows: PackedSplats, shift: Vector, hasFirstView: boolean): void {
    const { orbit } = this;
    if (orbit === undefined) return;
    const bulk = hasFirstView ? undefined : bulkOf(rows, shift);
    const ahead = bulk === undefined ? depthAhead(rows, shift, orbit.position, orbit.forward) : undefined;
    this.frame = (camera) => {
      if (bulk !== undefined) camera.frame(bulk.centre, bulk.radius);
      else if (ahead !== undefined) camera.turnAround(ahead);
    };
    if (!this.wasMoved) this.reset();
  }

  /** Leave the scene, before another one is open. */
  leave(): void {
    this.endMotion(true);
    this.orbit = undefined;
    this.wasMoved = false;
  }

  /** Return to the first pose. */
  reset(): void {
    this.endMotion(true);
    this.orbit = this.makeOrbit?.();
    if (this.orbit !== undefined) {
      this.orbit.isFree = this.isFree;
      this.frame?.(this.orbit);
      const { view, target } = this.start;
      if (view !== undefined) this.orbit.setPose(poseOf(view, this.orbit.up));
      if (this.chosen !== undefined) this.orbit.setPose(this.chosen);
      if (target !== undefined) this.orbit.setPose({ ...this.pose!, target });
    }
    this.wasMoved = false;
    this.host.redraw();
  }

  /** Change where the camera starts, and go there. */
  startFrom(start: Start): void {
    this.start = { ...this.start, ...start };
    this.reset();
  }

  /** Move the camera by a motion; an earlier motion ends. */
  move(motion: Motion): void {
    this.endMotion(false);
    this.motion = motion;
    this.host.redraw();
  }

  /** Whether a motion moves the camera. */
  get isMoving(): boolean {
    return this.motion !== undefined;
  }

  /** End the motion, if any. */
  endMotion(byPerson: boolean): void {
    if (this.motion === undefined) return;
    this.motion = undefined;
    this.host.motionEnded(byPerson);
  }

  /** Move the camera by the motion; return whether one goes on. */
  step(seconds: number): boolean {
    const { motion, orbit } = this;
    if (motion === undefined || orbit === undefined || !this.visible) return false;
    this.wasMoved = true;
    if (!motion(orbit, seconds) && this.motion === motion) this.endMotion(false);
    return true;
  }

  /** Report the camera's rest some time after the last call that finds another pose than the call before. */
  watchRest(): void {
    const { pose } = this;
    if (this.orbit === undefined || pose === undefined) return;
    const seen = [pose.rotation, pose.translation, pose.fy / pose.height].join();
    if (seen === this.seen) return;
    this.seen = seen;
    this.awaitRest();
  }

  /** End the timer of the rest. */
  close(): void {
    clearTimeout(this.resting);
  }

  private awaitRest(): void {
    clearTimeout(this.resting);
    this.resting = setTimeout(() => {
      if (this.isMoving || this.host.isHeld()) this.awaitRest();
      else this.host.rested();
    }, REST_MILLISECONDS);
  }
}
