import math
import struct

import numpy as np
import pytest
from heads import decode

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import grid_planes, scale_differences
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Kind, Stream

f32 = np.float32


def scales_of(seed, rows):
    """Log scales: middle, thin, long."""
    scales = np.random.default_rng(seed).normal(-4, 1.2, (rows, 3))
    return np.sort(scales, axis=1)[:, [1, 0, 2]].astype(f32)


def refusal(*given_streams):
    with pytest.raises(FormatError, match="chunk 7") as caught:
        decode(*given_streams)
    return caught.value.code, caught.value.clause


def changed(stream, **changes):
    values = {name: getattr(stream, name) for name in stream.__dataclass_fields__} | changes
    return Stream(**values)


@pytest.mark.parametrize("step", [1.0, 0.1, 1e-4])
def test_scales_stay_within_their_steps(step):
    scales = scales_of(1, 400)
    steps = scale_differences.differences_of(scales)
    assert (steps[:, 1:] >= 0).all()
    grid = grids.fit(steps, step)
    out = decode(scale_differences.write(steps, grid)).scales
    # Errors of half a step each: the long axis has one, the middle two, the thin three.
    error = np.abs(out.astype(np.float64) - scales)
    assert (error <= np.array([2, 3, 1]) * step * 0.5001 + 4e-6).all()
    assert (out[:, 1] <= out[:, 0] + 1e-6).all()
    assert (out[:, 0] <= out[:, 2] + 1e-6).all()


def test_differences_accumulate_in_the_documented_order():
    rng = np.random.default_rng(2)
    grid = Grid(
        np.array([-9, -0.5, 0], f32),
        np.array([2.3, 7, 0.7], f32),
        np.array([300, 5, 70_000], np.uint32),
    )
    codes = rng.integers(0, grid.levels, (64, 3)).astype(np.uint32)
    planes = []
    for component in range(3):
        planes += grid_planes.split_planes(codes[:, component], int(grid.levels[component]))
    out = decode(Stream(Attribute.SCALES, Kind.DIFFERENCES, 64, grid.pack(), planes)).scales
    for row in range(64):
        l, u, v = (  # noqa: E741 - as the clause names them
            f32(f32(f32(code) * f32(f32(high - low) / f32(levels - 1))) + low)
            for code, low, high, levels in zip(
                codes[row], grid.minimum, grid.maximum, grid.levels.astype(f32), strict=True
            )
        )
        middle = f32(l - u)
        assert out[row].tobytes() == np.array([middle, f32(middle - v), l], f32).tobytes()


def test_one_shape_costs_no_plane():
    steps = scale_differences.differences_of(np.tile(np.array([[-4, -6, -3.5]], f32), (9, 1)))
    stream = scale_differences.write(steps, grids.fit(steps, 0.1))
    assert list(stream.planes) == []
    np.testing.assert_allclose(decode(stream).scales, [[-4, -6, -3.5]] * 9, atol=1e-6)


def test_streams_that_break_the_rules_are_refused():
    steps = scale_differences.differences_of(scales_of(3, 20))
    good = scale_differences.write(steps, grids.fit(steps, 0.1))
    decode(good)
    for params in (b"", good.params[:-1], good.params + b"\0", good.params[:24]):
        assert refusal(changed(good, params=params)) == ("stream-params", "6.2")
    for planes in (good.planes[:-1], [*good.planes, good.planes[0]]):
        assert refusal(changed(good, planes=planes)) == ("stream-planes", "6.2")
    short = [plane[:-1] for plane in good.planes]
    assert refusal(changed(good, planes=short)) == ("plane-length", "6.3")
    levels = grids.unpack(memoryview(good.params), 3, "here").levels
    for component in range(3):
        planes = [plane.copy() for plane in good.planes]
        planes[component][4] = levels[component]
        assert refusal(changed(good, planes=planes)) == ("code-range", "6.4")
    for value, code in ((math.nan, "grid-value"), (2e30, "grid-value")):
        params = struct.pack("<f", value) + good.params[4:]
        assert refusal(changed(good, params=params)) == (code, "6.4")
    for levels in (0, grids.MAX_LEVELS + 1):
        params = good.params[:8] + struct.pack("<I", levels) + good.params[12:]
        assert refusal(changed(good, params=params)) == ("grid-levels", "6.4")


def test_differences_stand_for_scales_alone():
    steps = scale_differences.differences_of(scales_of(4, 5))
    stream = scale_differences.write(steps, grids.fit(steps, 0.1))
    for attribute in (Attribute.MEANS, Attribute.SH0):
        assert refusal(changed(stream, attribute=attribute)) == ("stream-kind", "6.2")
