import assert from "node:assert/strict";
import { test } from "node:test";

import { movedCapture, trainingPixel } from "../src/scene/training_pixel.js";

const CAPTURE = [
  { position: [0.5, -0.25, -2], focalPx: 60 },
  { position: [-3, 1, -4], focalPx: 25 },
  { position: [4, 2, 3], focalPx: 40 },
] as const;

const distance = (a: readonly number[], b: readonly number[]): number => Math.hypot(...a.map((v, i) => v - b[i]!));

test("the pixel of training is the mean of the viewpoints' pixels, weighted by nearness to the viewer", () => {
  const viewer = [1, 0.5, -6];
  const [x, y, z, area, rest] = trainingPixel(CAPTURE, viewer);
  const weights = CAPTURE.map(({ position }) => distance(position, viewer) ** -4);
  for (const place of [
    [0, 0, 0],
    [2, -1, 5],
    [-40, 3, 1],
  ]) {
    const sum = weights.reduce((a, b) => a + b);
    const pixels = CAPTURE.map(({ position, focalPx }) => (distance(position, place) / focalPx) ** 2);
    const expected = pixels.reduce((total, pixel, i) => total + (pixel * weights[i]!) / sum, 0);
    const found = area * distance([x, y, z], place) ** 2 + rest;
    assert.ok(Math.abs(found / expected - 1) < 1e-12);
  }
});

test("a viewer at a viewpoint has its pixel alone, and without viewpoints there is none", () => {
  assert.deepEqual(trainingPixel(CAPTURE, [-3, 1, -4]), [-3, 1, -4, 1 / 625, 0]);
  assert.deepEqual(trainingPixel([], [1, 2, 3]), [0, 0, 0, 0, 0]);
});

test("viewpoints move with the zero of their space", () => {
  assert.deepEqual(movedCapture(CAPTURE.slice(0, 1), [1, 2, 3]), [{ position: [1.5, 1.75, 1], focalPx: 60 }]);
});
