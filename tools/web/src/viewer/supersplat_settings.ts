import type { Annotation, CameraPath, Description } from "../container/description.js";
import type { Pinhole } from "../container/pinhole.js";
import { aheadOf, distance, positionOf } from "./flight.js";
import type { Vector } from "./orbit.js";
import { rightDownFront } from "./sky.js";
import { poseOf } from "./view_text.js";
import type { ViewerPose } from "./viewer_handle.js";

/** Version of the settings (SuperSplat's user manual, Experience Settings). */
const VERSION = 2;
/** Field of view of settings of the first version that state none, degrees. */
const FIRST_FOV = 60;
/** Frames a second of written tracks, whose times are in frames. */
const FRAME_RATE = 30;
/** Side of the picture of a pose, px. */
const SIDE = 1080;
/** Stops of a path at most (SPEC 5.13). */
const MOST_STOPS = 1024;

/** Parts of a description that settings hold. */
export type SettingsParts = Pick<Description, "background" | "path" | "annotations">;

/** Space of a scene, which settings do not share. */
export interface SceneSpace {
  /** Axes of the scene, such as `RDF`. */
  readonly axes: string;
  /** Unit vector against gravity, about which poses are level. */
  readonly up: Vector;
}

interface SettingsPose {
  readonly position: readonly number[];
  readonly target: readonly number[];
  readonly fov: number;
}

/** Return SuperSplat's settings of a description and of the pose in which its viewer starts. */
export function exportSettings(parts: SettingsParts, start: ViewerPose, { axes }: SceneSpace): object {
  const turned = rightDownFront(axes);
  // SuperSplat turns scenes by 180 degrees about the front.
  const point = (p: readonly number[]): number[] =>
    [-1, -1, 1].map((sign, i) => p.reduce((sum, value, k) => sum + sign * turned[3 * i + k]! * value, 0));
  const pose = (view: ViewerPose): SettingsPose => {
    const position = positionOf(view);
    const far = view.target === undefined ? 1 : distance(position, view.target);
    const fov = (2 * Math.atan(view.height / (2 * view.fy)) * 180) / Math.PI;
    return { position: point(position), target: point(aheadOf(view, position, far)), fov };
  };
  const { background, path, annotations } = parts;
  const poses = path?.stops.map(pose) ?? [];
  const track = {
    name: "path",
    duration: path?.stops.at(-1)?.time,
    frameRate: FRAME_RATE,
    loopMode: path?.loop ? "repeat" : "none",
    interpolation: "spline",
    smoothness: 1,
    keyframes: {
      times: path?.stops.map(({ time }) => time * FRAME_RATE),
      values: {
        position: poses.flatMap(({ position }) => position),
        target: poses.flatMap(({ target }) => target),
        fov: poses.map(({ fov }) => fov),
      },
    },
  };
  return {
    version: VERSION,
    tonemapping: "none",
    highPrecisionRendering: false,
    background: { color: background ?? [0, 0, 0] },
    postEffectSettings: {
      sharpness: { enabled: false, amount: 0 },
      bloom: { enabled: false, intensity: 1, blurLevel: 2 },
      grading: { enabled: false, brightness: 0, contrast: 1, saturation: 1, tint: [1, 1, 1] },
      vignette: { enabled: false, intensity: 0.5, inner: 0.3, outer: 0.75, curvature: 1 },
      fringing: { enabled: false, intensity: 0.5 },
    },
    animTracks: path === undefined ? [] : [track],
    cameras: [{ initial: pose(start) }],
    annotations: annotations.map(({ place, title, text, view }) => ({
      position: point(place),
      title,
      text,
      extras: {},
      camera: { initial: pose(view ?? start) },
    })),
    startMode: "default",
  };
}

/**
 * Read SuperSplat's settings.
 *
 * @returns The parts of a description, and the pose in which the viewer starts, if any.
 * @throws SyntaxError if the text is no settings of the first version, which states none, or of version 2.
 */
export function importSettings(
  text: string,
  { axes, up }: SceneSpace,
): { readonly parts: SettingsParts; readonly start: ViewerPose | undefined } {
  const root = fromFirstVersion(new Item(JSON.parse(text), "settings"));
  if (root.at("version").value !== VERSION) throw root.refusal(`expected settings of version ${VERSION}`);
  const turned = rightDownFront(axes);
  const point = (p: readonly number[]): Vector =>
    [0, 1, 2].map((k) => [-1, -1, 1].reduce((sum, sign, i) => sum + sign * turned[3 * i + k]! * p[i]!, 0)) as Vector;
  const view = (position: readonly number[], target: readonly number[], fov: number): Pinhole => {
    if (!(fov > 0 && fov < 180)) throw root.refusal(`a field of view of ${fov} degrees`);
    const found = poseOf({ position: point(position), target: point(target), fov, roll: 0 }, up);
    const [fx, fy] = [found.fx * SIDE, found.fy * SIDE];
    return { ...found, width: SIDE, height: SIDE, fx, fy, cx: SIDE / 2, cy: SIDE / 2 };
  };
  const pose = (item: Item): Pinhole =>
    view(item.at("position").numbers(3), item.at("target").numbers(3), item.at("fov").numbers()[0]!);
  const path = (track: Item): CameraPath | undefined => {
    const [times, values] = [track.at("keyframes").at("times").numbers(), track.at("keyframes").at("values")];
    const rate = track.at("frameRate").numbers()[0]!;
    const isAscending = times.every((time, i) => i === 0 || time > times[i - 1]!);
    if (!isAscending || !(rate > 0) || times.length > MOST_STOPS) throw track.refusal("times that do not ascend");
    if (times.length < 2) return undefined;
    const [positions, targets] = ["position", "target"].map((key) => values.at(key).numbers(3 * times.length));
    const fovs = values.at("fov").numbers(times.length);
    const stops = times.map((time, i) => ({
      time: (time - times[0]!) / rate,
      ...view(positions!.slice(3 * i, 3 * i + 3), targets!.slice(3 * i, 3 * i + 3), fovs[i]!),
    }));
    const loop = track.at("loopMode").value === "repeat";
    const duration = track.at("duration").numbers()[0]!;
    if (loop && duration > stops.at(-1)!.time && stops.length < MOST_STOPS) {
      // SuperSplat moves on to the first view until the track ends.
      stops.push({ ...stops[0]!, time: duration });
    }
    return { loop, stops };
  };
  const background = root.at("background").at("color");
  const [camera, track] = [root.at("cameras").items()[0], root.at("animTracks").items()[0]];
  const annotations = root
    .at("annotations")
    .items()
    .map((item): Annotation => {
      const [title, given] = [item.at("title").value, item.at("text").value];
      const initial = item.at("camera").at("initial");
      return {
        place: point(item.at("position").numbers(3)),
        title: String(title ?? ""),
        text: String(given ?? ""),
        view: initial.value === undefined ? undefined : pose(initial),
      };
    });
  const parts = {
    background:
      background.value === undefined
        ? undefined
        : background.numbers(3).map((share) => Math.min(Math.max(share, 0), 1)),
    path: track && path(track),
    annotations,
  };
  return { parts, start: camera && pose(camera.at("initial")) };
}

/** Return settings of the first version, which states none, as settings of version 2; others as they are. */
function fromFirstVersion(root: Item): Item {
  const camera = root.at("camera");
  if (root.at("version").value !== undefined || camera.value === undefined) return root;
  const [position, target] = [camera.at("position").value, camera.at("target").value];
  const fov = camera.at("fov").value ?? FIRST_FOV;
  const animTracks = root
    .at("animTracks")
    .items()
    .map((track) => {
      const times = track.at("keyframes").at("times").numbers();
      const values = { ...(track.at("keyframes").at("values").value as object), fov: times.map(() => fov) };
      // Times are in seconds where the track states no frame rate.
      return { frameRate: 1, ...(track.value as object), keyframes: { times, values } };
    });
  const cameras = position === undefined || target === undefined ? [] : [{ initial: { position, target, fov } }];
  return root.with({ version: VERSION, background: root.at("background").value, cameras, animTracks });
}

/** A value of the settings, and where it stands. */
class Item {
  constructor(
    readonly value: unknown,
    private readonly where: string,
  ) {}

  /** Return the value of a key; of undefined where there is none. */
  at(key: string): Item {
    const { value, where } = this;
    const isMap = typeof value === "object" && value !== null && Object.hasOwn(value, key);
    return new Item(isMap ? (value as Record<string, unknown>)[key] : undefined, `${where}.${key}`);
  }

  /** Return another value in the same place. */
  with(value: object): Item {
    return new Item(value, this.where);
  }

  /** Return the items of a list; none of a missing one. */
  items(): Item[] {
    const { value, where } = this;
    if (value === undefined) return [];
    if (!Array.isArray(value)) throw this.refusal("expected a list");
    return value.map((item, i) => new Item(item, `${where}[${i}]`));
  }

  /** Return numbers: a list of some length, or one alone. */
  numbers(length?: number): number[] {
    const found: unknown[] = Array.isArray(this.value) ? this.value : [this.value];
    if (!found.every((value) => Number.isFinite(value)) || (length ?? found.length) !== found.length) {
      throw this.refusal(length === undefined ? "expected numbers" : `expected ${length} numbers`);
    }
    return found as number[];
  }

  refusal(problem: string): SyntaxError {
    return new SyntaxError(`${this.where}: ${problem}`);
  }
}
