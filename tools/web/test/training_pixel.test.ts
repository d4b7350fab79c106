import assert from "node:assert/strict";
import { test } from "node:test";

import { movedCapture, trainingPixel, trainingPixelInView } from "../src/scene/training_pixel.js";

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

test("in the space of a camera the pixel of training has the size that the matrices give it", () => {
  // The camera looks along −z from 5 before the world's zero; the scene is turned about z, twice as large, and shifted.
  const view = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -5, 1];
  const model = [0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 2, 0, 1, 3, -1, 1];
  const seen = ([x, y, z]: readonly [number, number, number]) => [1 - 2 * y, 3 + 2 * x, 2 * z - 6];
  const viewer = [-1.5, 0.5, 3];
  assert.deepEqual(seen([-1.5, 0.5, 3]), [0, 0, 0]);
  const means = trainingPixel(CAPTURE, viewer);
  const [x, y, z, area, rest] = trainingPixelInView(CAPTURE, view, model);
  for (const mean of [
    [0, 0, 0],
    [2, -1, 5],
  ] as const) {
    const expected = 4 * (means[3] * distance(means.slice(0, 3), mean) ** 2 + means[4]);
    const found = area * distance([x, y, z], seen(mean)) ** 2 + rest;
    assert.ok(Math.abs(found / expected - 1) < 1e-12);
  }
});

test("viewpoints move with the zero of their space", () => {
  assert.deepEqual(movedCapture(CAPTURE.slice(0, 1), [1, 2, 3]), [{ position: [1.5, 1.75, 1], focalPx: 60 }]);
});
