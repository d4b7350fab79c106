import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { positionOf } from "../src/viewer/flight.js";
import { exportSettings, importSettings } from "../src/viewer/supersplat_settings.js";
import { poseOf } from "../src/viewer/view_text.js";

const SPACE = { axes: "RDF", up: [0, -1, 0] as [number, number, number] };
const pose = (position: [number, number, number], target: [number, number, number], fov: number) => ({
  ...poseOf({ position, target, fov, roll: 0 }, SPACE.up),
  ...{ width: 1, cx: 0.5, cy: 0.5 },
});
const START = pose([1, 2, 3], [1, 2, 8], 50);
const PARTS = {
  background: [0.25, 0.5, 1],
  path: {
    loop: true,
    stops: [
      { time: 0, ...START },
      { time: 2.5, ...pose([2, 2, 3], [1, 3, 8], 40) },
    ],
  },
  annotations: [{ place: [1, 2, 8], title: "Here", text: "<b>text</b>", view: START }],
};

interface Written {
  readonly version: number;
  readonly cameras: readonly { readonly initial: { position: number[]; target: number[]; fov: number } }[];
  readonly animTracks: readonly { readonly loopMode: string; readonly keyframes: { readonly times: number[] } }[];
  readonly annotations: readonly { readonly position: number[] }[];
}

const near = (a: readonly number[], b: readonly number[]): boolean =>
  a.length === b.length && a.every((value, i) => Math.abs(value - b[i]!) < 1e-9);

test("settings are in the space of SuperSplat, which turns scenes by 180 degrees", () => {
  const written = exportSettings(PARTS, START, SPACE) as Written;
  assert.equal(written.version, 2);
  const { position, target, fov } = written.cameras[0]!.initial;
  assert.ok(near(position, [-1, -2, 3]) && near(target, [-1, -2, 8]) && Math.abs(fov - 50) < 1e-9);
  assert.deepEqual(written.animTracks[0]!.keyframes.times, [0, 75]);
  assert.equal(written.animTracks[0]!.loopMode, "repeat");
  assert.ok(near(written.annotations[0]!.position, [-1, -2, 8]));
});

test("settings come back as they were, in any axes", () => {
  for (const axes of ["RDF", "RUB", "FLU"]) {
    const space = { axes, up: [0, 0, 1] as [number, number, number] };
    const start = poseOf({ position: [1, 2, 3], target: [4, 1, 8], fov: 50, roll: 0 }, space.up);
    const text = JSON.stringify(exportSettings(PARTS, start, space));
    const { parts, start: found } = importSettings(text, space);
    assert.ok(near(found!.rotation, start.rotation) && near(found!.translation, start.translation));
    assert.ok(near(found!.target!, [4, 1, 8]) && Math.abs(found!.fy / found!.height - start.fy) < 1e-9);
    assert.deepEqual(parts.background, PARTS.background);
    assert.equal(parts.path!.loop, true);
    assert.ok(
      near(
        parts.path!.stops.map(({ time }) => time),
        [0, 2.5],
      ),
    );
    parts.path!.stops.forEach((stop, i) => {
      assert.ok(near(positionOf(stop), positionOf(PARTS.path.stops[i]!)));
    });
    const [annotation] = parts.annotations;
    assert.deepEqual([annotation!.title, annotation!.text], ["Here", "<b>text</b>"]);
    assert.ok(near(annotation!.place, [1, 2, 8]));
  }
});

interface Case {
  readonly name: string;
  readonly axes: string;
  readonly up: [number, number, number];
  readonly settings: object;
  readonly expected: {
    readonly background: readonly number[];
    readonly start: { readonly position: readonly number[]; readonly target: readonly number[] } | null;
    readonly loop: boolean | null;
    readonly stops: readonly { readonly time: number; readonly position: readonly number[] }[];
    readonly places: readonly (readonly number[])[];
    readonly titles: readonly string[];
  };
}

test("settings mean what they mean in Python", () => {
  const cases = JSON.parse(readFileSync("test/supersplat_cases.json", "utf8")) as Case[];
  for (const { name, axes, up, settings, expected } of cases) {
    const { parts, start } = importSettings(JSON.stringify(settings), { axes, up });
    const { background, path, annotations } = parts;
    assert.deepEqual(background, expected.background, name);
    assert.equal(start === undefined, expected.start === null, name);
    if (start !== undefined && expected.start !== null) {
      assert.ok(near(positionOf(start), expected.start.position) && near(start.target!, expected.start.target), name);
    }
    assert.equal(path?.loop ?? null, expected.loop, name);
    assert.deepEqual(
      path?.stops.map(({ time }) => time) ?? [],
      expected.stops.map(({ time }) => time),
    );
    expected.stops.forEach(({ position }, i) => {
      assert.ok(near(positionOf(path!.stops[i]!), position), name);
    });
    expected.places.forEach((place, i) => {
      assert.ok(near(annotations[i]!.place, place), name);
    });
    assert.deepEqual(
      annotations.map(({ title }) => title),
      expected.titles,
    );
  }
});

test("other files are refused with the place of the fault", () => {
  const good = exportSettings(PARTS, START, SPACE) as unknown as Record<string, unknown>;
  const refused = (changes: object, place: RegExp): void => {
    assert.throws(() => importSettings(JSON.stringify({ ...good, ...changes }), SPACE), place);
  };
  assert.throws(() => importSettings("no JSON", SPACE), SyntaxError);
  refused({ version: 3 }, /settings: expected settings of version 2/);
  refused(
    { cameras: [{ initial: { position: [1, 2], target: [0, 0, 0], fov: 40 } }] },
    /cameras\[0\]\.initial\.position/,
  );
  refused({ cameras: [{ initial: { position: [1, 2, 3], target: [0, 0, 0], fov: 190 } }] }, /190 degrees/);
  refused({ annotations: 7 }, /settings\.annotations: expected a list/);
  refused({ background: { color: ["red"] } }, /background\.color/);
});
