"""Pictures of the vectors: rounding decides no pixel, and every rule of SPEC 8.7 shows in one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from cogsplat.tools.lab.conformance import drawing_vectors, reference_decoder, tolerance
from cogsplat.tools.lab.conformance import reference_drawing as reference

SCENES = drawing_vectors.scenes()
DRAWINGS = {drawing.name: drawing for drawing in drawing_vectors.drawings()}


def draw(name: str) -> NDArray[np.float32]:
    """Draw a picture as the reference does now."""
    drawing = DRAWINGS[name]
    values = reference.draw(SCENES[drawing.scene], drawing.camera)
    shape = (drawing.camera.height, drawing.camera.width, 3)
    return np.array(values, np.float32).reshape(shape)


@cache
def expected(name: str) -> NDArray[np.float32]:
    return draw(name)


def faults(name: str) -> tuple[str, str]:
    """Return the faults that the reference has now, by the tolerances of readers and viewers."""
    now, right = draw(name), expected(name)
    return (
        tolerance.picture_fault(now, right, is_viewer=False),
        tolerance.picture_fault(now, right, is_viewer=True),
    )


@pytest.mark.parametrize("name", DRAWINGS)
def test_no_pixel_depends_on_rounding(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    right = expected(name)
    for constant in ("_ALPHA_LEAST", "_TRANSMITTANCE_LEAST", "_NEAR"):
        value = getattr(reference, constant)
        for factor in (0.9999, 1.0001):
            with monkeypatch.context() as patch:
                patch.setattr(reference, constant, factor * value)
                np.testing.assert_array_equal(draw(name), right, err_msg=constant)
    camera = DRAWINGS[name].camera
    means = reference_decoder.decode(SCENES[DRAWINGS[name].scene]).rows["means"]
    turn = np.reshape(camera.rotation, (3, 3))
    depths = np.sort((np.array(means) @ turn.T + camera.translation)[:, 2])
    assert np.diff(depths[depths > 0.2]).min() > 1e-4


def test_the_picture_of_training_is_the_usual_one() -> None:
    np.testing.assert_array_equal(expected("same"), expected("usual"))


@pytest.mark.parametrize(
    ("constant", "value", "name"),
    [
        ("_NEAR", 0.0, "usual"),
        ("_NEAR", 0.22, "usual"),
        ("_ALPHA_LEAST", 1 / 510, "usual"),
        ("_ALPHA_LEAST", 1 / 200, "usual"),
        ("_ALPHA_MOST", 0.999, "usual"),
        ("_ALPHA_MOST", 1.0, "usual"),
        ("_TRANSMITTANCE_LEAST", 0.0, "usual"),
        ("_GUARD", 0.15, "usual"),
        ("_GUARD", 10.0, "usual"),
        ("_GUARD", 0.25, "oblique"),
    ],
)
def test_another_constant_shows(
    constant: str, value: float, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected(name)
    monkeypatch.setattr(reference, constant, value)
    assert faults(name)[0]


Added = Callable[[reference.Camera, reference._Kernel, list[float]], tuple[float, float]]
ADDED: Added = reference._added


def kernel_with(**changes: object) -> Added:
    """Return the right rule, applied to a scene whose keys are changed."""
    return lambda camera, kernel, mean: ADDED(camera, replace(kernel, **changes), mean)


def share_of(camera: reference.Camera, kernel: reference._Kernel, mean: list[float]) -> float:
    return ADDED(camera, kernel, mean)[0] / kernel.kernel_px


def by_share(change: Callable[[float], float]) -> Added:
    """Return a rule with another share of the areas of pixels."""

    def added(
        camera: reference.Camera, kernel: reference._Kernel, mean: list[float]
    ) -> tuple[float, float]:
        share = change(share_of(camera, kernel, mean))
        return kernel.kernel_px * share, max(0.0, 1.0 - share) / 12.0

    return added


def by_depth(
    camera: reference.Camera, kernel: reference._Kernel, mean: list[float]
) -> tuple[float, float]:
    """Take the depth of a splat for its distance from the camera."""
    r, t = camera.rotation, camera.translation
    depth = sum(r[6 + j] * mean[j] for j in range(3)) + t[2]
    square = reference._squared_distance(mean, reference._position(camera))
    return by_share(lambda share: share * square / depth**2)(camera, kernel, mean)


def weighted(power: float) -> Added:
    """Return a rule with another power of the distances from viewpoints."""

    def added(
        camera: reference.Camera, kernel: reference._Kernel, mean: list[float]
    ) -> tuple[float, float]:
        position = reference._position(camera)
        squares = [reference._squared_distance(view[:3], position) for view in kernel.capture]
        weights = [max(square, 1e-12) ** (-power / 2) for square in squares]
        shares = [
            share_of(camera, replace(kernel, capture=[view]), mean) for view in kernel.capture
        ]
        share = float(np.average(shares, weights=weights))
        return kernel.kernel_px * share, max(0.0, 1.0 - share) / 12.0

    return added


WRONG: dict[str, tuple[Added, str]] = {
    "viewpoints ignored, smaller": (kernel_with(capture=[]), "half"),
    "viewpoints ignored, farther": (kernel_with(capture=[]), "far"),
    "viewpoints ignored, nearer": (kernel_with(capture=[]), "near"),
    "viewpoints ignored, several": (kernel_with(capture=[]), "between"),
    "antialiased ignored": (kernel_with(antialiased=False), "antialiased"),
    "antialiased for others": (kernel_with(antialiased=True), "usual"),
    "no filter": (lambda *splat: (ADDED(*splat)[0], 0.0), "quarter"),
    "no thickness": (lambda *splat: (0.0, ADDED(*splat)[1]), "large"),
    "never thicker than the kernel": (by_share(lambda share: min(share, 1.0)), "near"),
    "sides of pixels for areas": (by_share(lambda share: share**0.5), "quarter"),
}
WRONG_FOR_READERS: dict[str, tuple[Added, str]] = {
    "another kernel": (kernel_with(kernel_px=0.3), "between"),
    "depth for distance": (by_depth, "between"),
    "all viewpoints alike": (weighted(0), "between"),
    "weights by the square": (weighted(2), "between"),
    "weights by the eighth power": (weighted(8), "between"),
    "all viewpoints alike, at one": (weighted(0), "at-one"),
    "two thirds of the filter": (
        lambda *splat: (ADDED(*splat)[0], ADDED(*splat)[1] / 1.5),
        "half",
    ),
}


@pytest.mark.parametrize("rule", [*WRONG, *WRONG_FOR_READERS])
def test_another_rule_of_thickness_shows(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    added, name = (WRONG | WRONG_FOR_READERS)[rule]
    expected(name)
    monkeypatch.setattr(reference, "_added", added)
    of_reader, of_viewer = faults(name)
    assert of_reader
    assert of_viewer or rule in WRONG_FOR_READERS


def test_another_order_or_colour_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    right = reference._ellipse
    expected("usual")
    expected("oblique")

    def by_row(*splat: object) -> object:
        ellipse = right(*splat)
        return ellipse and replace(ellipse, depth=0.0)

    with monkeypatch.context() as patch:
        patch.setattr(reference, "_ellipse", by_row)
        assert all(faults("usual"))
    colour = reference._colour
    with monkeypatch.context() as patch:
        patch.setattr(
            reference, "_colour", lambda c, mean, position: colour(c[:27], mean, position)
        )
        assert faults("usual")[0]
    # The direction of the picture's middle for that of the splat.
    with monkeypatch.context() as patch:
        patch.setattr(
            reference, "_colour", lambda c, mean, position: colour(c, [0.0, 0.0, 0.0], position)
        )
        assert all(faults("oblique"))
