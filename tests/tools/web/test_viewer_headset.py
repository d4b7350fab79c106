"""The viewer in a headset that the page makes, whose eyes see the halves of the canvas."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import look_from, picture, wait_until
from faulty_server import FaultyServer
from numpy.typing import NDArray
from running import SmallScene

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import render
from cogsplat.formats.cogs.description import Description
from cogsplat.tools.lab.synthetic.terrace import synth_cameras

if TYPE_CHECKING:
    from playwright.sync_api import Page

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
expect = sync_api.expect

pytestmark = pytest.mark.slow

F64 = NDArray[np.float64]

WIDTH, HEIGHT = 400, 300
COMPLETE = "s.state === 'complete' && s.upToDate"
SAME_DB = 38.0
# The eyes' pictures have 49 and 49 dB; 41 and 43 dB if tangents are clamped about the middle of the
# picture instead of the principal point.
EYE_DB = 45.0
"""What the picture of an eye must have against our own render."""
METRES_PER_UNIT = 0.5

TANGENTS = {"left": (-0.55, 0.35, 0.6, -0.7), "right": (-0.35, 0.55, 0.6, -0.7)}
"""Tangents of the left, right, upper and lower edge of what an eye sees."""

HEADSET = """
(eyes) => {
  const frames = [];
  class Session extends EventTarget {
    inputSources = [];
    updateRenderState() {}
    async requestReferenceSpace() { return {}; }
    requestAnimationFrame(draw) {
      frames.push(draw);
      requestAnimationFrame((time) => {
        const draw = frames.pop();
        if (draw === undefined || window.headset.ended) return;
        draw(time, { getViewerPose: () => window.headset.pose });
        window.headset.frames++;
      });
    }
    async end() {
      window.headset.ended = true;
      this.dispatchEvent(new Event("end"));
    }
  }
  window.XRWebGLLayer = class {
    framebuffer = null;
    getViewport({ projectionMatrix }) {
      const { views } = window.headset.pose;
      const eye = views.findIndex((it) => it.projectionMatrix === projectionMatrix);
      return { x: 200 * eye, y: 0, width: 200, height: 300 };
    }
  };
  window.headset = { session: new Session(), pose: eyes, frames: 0, asked: 0, ended: false };
  WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
  Object.defineProperty(navigator, "xr", {
    value: {
      isSessionSupported: async (mode) => mode === "immersive-vr",
      requestSession: async () => { window.headset.asked++; return window.headset.session; },
    },
  });
}
"""


def camera() -> Camera:
    return synth_cameras(48, WIDTH, HEIGHT)[8]


def eye_matrix(offset: float) -> F64:
    """Return the pose of an eye in the headset's space: turned to the left, and tilted."""
    yaw, tilt = 0.15, -0.1
    turn = np.array(
        [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    ) @ np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    matrix[:3, 3] = np.array([0.1, 0.05, 0.2]) + turn[:, 0] * offset
    return matrix


def projection(left: float, right: float, top: float, bottom: float) -> F64:
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 / (right - left), (right + left) / (right - left)
    matrix[1, 1], matrix[1, 2] = 2 / (top - bottom), (top + bottom) / (top - bottom)
    matrix[2, 2], matrix[2, 3], matrix[3, 2] = -1.0, -0.2, -1.0
    return matrix


def columns(matrix: F64) -> list[float]:
    found: list[float] = matrix.T.ravel().tolist()
    return found


def pose() -> dict[str, object]:
    """Return the pose that WebXR gives."""
    return {
        "transform": {"matrix": columns(eye_matrix(0.0))},
        "views": [
            {
                "projectionMatrix": columns(projection(*TANGENTS[name])),
                "transform": {"matrix": columns(eye_matrix(offset))},
            }
            for name, offset in (("left", -0.032), ("right", 0.032))
        ],
    }


def eye_camera(name: str, offset: float, up: F64) -> Camera:
    """Return the camera of one eye, shifted sideways from the view."""
    view = camera()
    front = view.rotation[2]
    right = np.cross(front, up)
    right /= np.linalg.norm(right)
    # The headset's right, up and back in the scene.
    axes = np.stack([right, up, np.cross(right, up)], axis=1)
    matrix = eye_matrix(offset)
    rotation = (axes @ matrix[:3, :3] @ np.diag([1.0, -1.0, -1.0])).T
    position = view.position + axes @ matrix[:3, 3] / METRES_PER_UNIT
    left, right_edge, top, bottom = TANGENTS[name]
    fx, fy = 200 / (right_edge - left), 300 / (top - bottom)
    return Camera(200, 300, fx, fy, -left * fx, top * fy, rotation, -rotation @ position)


def test_each_eye_sees_the_scene_in_its_scale(
    page: Page, server: FaultyServer, small: SmallScene, tmp_path: Path
) -> None:
    scene = tmp_path / "scene.cogs"
    cogsplat.describe(small.cogs, Description(metres_per_unit=METRES_PER_UNIT), scene)
    with cogsplat.open(scene) as file:
        up = np.array([0.0, -1.0, 0.0]) if file.root.up is None else np.array(file.root.up)
    server.files["scene.cogs"] = scene.read_bytes()
    page.add_init_script(f"({HEADSET})()")
    page.goto(server.url)
    look_from(page, camera())
    wait_until(page, COMPLETE)
    page.evaluate("(pose) => { window.headset.pose = pose; }", pose())
    before = picture(page)
    view = page.evaluate("() => cogsplatViewer.view")
    page.get_by_role("button", name="View in VR").click()
    page.wait_for_function("() => window.headset.frames > 5")
    splats = cogsplat.decode(scene)
    for _ in range(20):
        # The splats are being sorted for the head.
        page.wait_for_timeout(100)
        found = picture(page)
        quality = [
            psnr(found[:, x : x + 200], np.clip(render(splats, eye_camera(name, offset, up)), 0, 1))
            for name, offset, x in (("left", -0.032, 0), ("right", 0.032, 200))
        ]
        if min(quality) >= EYE_DB:
            break
    assert min(quality) >= EYE_DB, quality
    # The button ends it, and the canvas shows what it showed before.
    page.get_by_role("button", name="View in VR").click()
    page.wait_for_function("() => window.headset.ended")
    wait_until(page, COMPLETE)
    assert np.allclose(page.evaluate("() => cogsplatViewer.view.rotation"), view["rotation"])
    assert psnr(picture(page), before) > SAME_DB


def test_thumbsticks_move_and_turn(page: Page, server: FaultyServer) -> None:
    page.goto(server.url)
    expect(page.get_by_role("button", name="Settings")).to_be_visible()
    expect(page.get_by_role("button", name="View in VR")).to_be_hidden()
    page.add_init_script(f"({HEADSET})()")
    page.goto(server.url)
    look_from(page, camera())
    wait_until(page, COMPLETE)
    page.evaluate("(pose) => { window.headset.pose = pose; }", pose())
    page.get_by_role("button", name="View in VR").click()
    page.wait_for_function("() => window.headset.frames > 2")

    def head() -> tuple[F64, F64]:
        found = page.evaluate("() => cogsplatViewer.view")
        rotation = np.array(found["rotation"]).reshape(3, 3)
        return rotation, -rotation.T @ np.array(found["translation"])

    def push(hand: str, x: float, y: float, frames: int) -> None:
        page.evaluate(
            """([handedness, x, y]) => {
              const { session } = window.headset;
              session.inputSources = [{ handedness, gamepad: { axes: [0, 0, x, y] } }];
              window.headset.frames = 0;
            }""",
            [hand, x, y],
        )
        page.wait_for_function("(frames) => window.headset.frames > frames", arg=frames)
        page.evaluate("() => { window.headset.session.inputSources = []; }")

    rotation, position = head()
    push("left", 0.0, -1.0, 5)
    moved, there = head()
    assert np.allclose(moved, rotation)
    way = there - position
    assert np.linalg.norm(way) > 0
    # Forward: along the look of the head, without its tilt.
    assert np.dot(way, rotation[2]) > 0.95 * np.linalg.norm(way)
    assert abs(np.dot(way, rotation[0])) < 1e-6
    push("right", 1.0, 0.0, 5)
    turned, here = head()
    assert np.allclose(here, there, atol=1e-6)
    # Once by 30 degrees to the right, however long the stick is held.
    assert np.dot(rotation[0], turned[2]) > 0
    angle = np.arccos((np.trace(turned @ moved.T) - 1) / 2)
    assert np.isclose(np.degrees(angle), 30, atol=1e-3)
