import numpy as np
import pytest
from hypothesis import settings
from streamed import grid_of, numbers, refused

from cogsplat.codec.streams import grid_planes, quaternion
from cogsplat.codec.streams.quaternion import PER_ROW
from cogsplat.codec.streams.records import Attribute, Kind, Stream

checked = settings(derandomize=True, deadline=None, max_examples=100)


def random_quats(seed, rows):
    quats = np.random.default_rng(seed).normal(size=(rows, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    quats[quats[:, 0] < 0] *= -1
    return quats.astype(np.float32)


def angles(a, b):
    """Angle between rotations, accurate for small ones."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    apart = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return 4 * np.arcsin(np.minimum(apart / 2, 1))


@pytest.mark.parametrize("step", [0.2, 0.02, 1e-3, 1e-5])
@pytest.mark.parametrize("largest", [0, 1, 2, 3, None])
def test_rotations_stay_within_the_angle_their_step_allows(step, largest):
    quats = random_quats(7, 3000)
    if largest is not None:
        quats = quats[np.abs(quats).argmax(axis=1) == largest]
    stream = quaternion.write(quats, step)
    assert stream.params[0] == (PER_ROW if largest is None else largest)
    out = numbers(stream)
    norms = np.sqrt(np.square(out.astype(np.float64)).sum(axis=1))
    np.testing.assert_allclose(norms, 1, atol=2e-7)
    assert (out[:, 0] >= 0).all()
    # Three components are off by half a step, the fourth, at least 1/2, by three times that, and
    # an angle by twice the distance: 2·√(3 + 9)/2 = 3.47 steps, and what curvature adds.
    assert angles(quats, out).max() <= 3.5 * step + 4 * step**2 + 1e-6


def scalar_quat(others, largest):
    """SPEC 6.6, one float32 operation at a time."""
    one = np.float32(1)
    a, b, c = (np.float32(v) for v in others)
    rest = one - np.float32(np.float32(np.float32(a * a) + np.float32(b * b)) + np.float32(c * c))
    four = [a, b, c]
    four.insert(largest, np.sqrt(max(np.float32(rest), np.float32(0))))
    w, x, y, z = four
    total = np.float32(np.float32(w * w) + np.float32(x * x))
    total = np.float32(np.float32(total + np.float32(y * y)) + np.float32(z * z))
    norm = np.sqrt(total)
    four = [np.float32(v / norm) for v in four]
    return [-v for v in four] if four[0] < 0 else four


@pytest.mark.parametrize("per_row", [False, True])
def test_rotations_decode_in_the_documented_order(per_row):
    rng = np.random.default_rng(8)
    rows = 64
    grid = grid_of([257, 31, 4096], -0.71, 0.71)
    codes = rng.integers(0, grid.levels, (rows, 3)).astype(np.uint32)
    which = rng.integers(0, 4, rows).astype(np.uint8) if per_row else np.full(rows, 2, np.uint8)
    planes = [which] if per_row else []
    for component in range(3):
        planes += grid_planes.split_planes(codes[:, component], int(grid.levels[component]))
    params = bytes([PER_ROW if per_row else 2, 0, 0, 0]) + grid.pack()
    out = numbers(Stream(Attribute.QUATS, Kind.QUAT, rows, params, planes))
    others = grid.dequantise(codes)
    for row in range(rows):
        expected = np.array(scalar_quat(others[row], int(which[row])), np.float32)
        assert out[row].tobytes() == expected.tobytes()


def test_rotations_that_leave_the_sphere_still_come_out_unit():
    grid = grid_of([2, 2, 2], -1.0, 1.0)
    codes = np.array([[0, 0, 0], [1, 1, 1], [0, 1, 0]], np.uint32)
    planes = [codes[:, component].astype(np.uint8) for component in range(3)]
    for largest in range(4):
        params = bytes([largest, 0, 0, 0]) + grid.pack()
        out = numbers(Stream(Attribute.QUATS, Kind.QUAT, 3, params, planes))
        np.testing.assert_allclose(np.square(out).sum(axis=1), 1, rtol=1e-6)
        assert (out[:, 0] >= 0).all()


def test_exact_axes_and_ties_come_back():
    half = np.float32(0.5)
    quats = np.array(
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1], [half, -half, half, -half]],
        np.float32,
    )
    out = numbers(quaternion.write(quats, 1e-4))
    assert angles(quats, out).max() <= 4e-4


def test_bad_rotation_parameters_are_refused():
    grid = grid_of([1, 1, 1], 0.0, 0.5).pack()
    for head, code in (
        (bytes([4, 0, 0, 0]), "quat-largest"),
        (bytes([254, 0, 0, 0]), "quat-largest"),
        (bytes([0, 1, 0, 0]), "quat-largest"),
        (bytes([0, 0, 0, 9]), "quat-largest"),
        (b"", "stream-params"),
        (bytes(5), "stream-params"),
    ):
        stream = Stream(Attribute.QUATS, Kind.QUAT, 1, head + grid, [])
        refused(lambda stream=stream: numbers(stream), code)
    for low, high in ((-1.001, 0.0), (0.0, 1.001)):
        params = bytes(4) + grid_of([1, 1, 1], low, high).pack()
        stream = Stream(Attribute.QUATS, Kind.QUAT, 1, params, [])
        refused(lambda stream=stream: numbers(stream), "grid-value", "6.6")
    params = bytes([PER_ROW, 0, 0, 0]) + grid
    stream = Stream(Attribute.QUATS, Kind.QUAT, 2, params, [np.array([3, 4], np.uint8)])
    refused(lambda: numbers(stream), "quat-largest", "6.6")
    for planes in ([], [np.zeros(2, np.uint8)] * 2):
        stream = Stream(Attribute.QUATS, Kind.QUAT, 2, params, planes)
        refused(lambda stream=stream: numbers(stream), "stream-planes", "6.2")
