import math
import struct

import numpy as np
import pytest
from heads import decode

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import sh0_transform
from cogsplat.codec.streams.grid import Grid, fit
from cogsplat.codec.streams.records import Attribute, Stream

f32 = np.float32


def changed(stream, **changes):
    values = {name: getattr(stream, name) for name in stream.__dataclass_fields__} | changes
    return Stream(**values)


def axes_of(seed):
    turned, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return turned.astype(f32)


def test_sh0_is_summed_in_the_documented_order():
    rng = np.random.default_rng(9)
    axes = axes_of(9)
    grid = Grid(
        np.array([-3, -1, 0], f32), np.array([5, 1, 0.5], f32), np.array([300, 7, 2], np.uint32)
    )
    values = rng.uniform(-3, 5, (80, 3)).astype(f32)
    stream = sh0_transform.write(values, axes, grid)
    out = decode(stream).sh0
    y = grid.dequantise(grid.quantise(values))
    for row in range(80):
        for channel in range(3):
            first = f32(y[row, 0] * axes[0, channel])
            pair = f32(first + f32(y[row, 1] * axes[1, channel]))
            assert out[row, channel] == f32(pair + f32(y[row, 2] * axes[2, channel]))


def test_sh0_on_turned_axes_stays_within_its_steps():
    rng = np.random.default_rng(10)
    axes = axes_of(10)
    sh0 = rng.normal(0, 1, (500, 3))
    on_axes = np.linalg.solve(axes.T.astype(float), sh0.T).T.astype(f32)
    stream = sh0_transform.write(on_axes, axes, fit(on_axes, 0.01))
    error = np.linalg.norm(decode(stream).sh0 - sh0, axis=1)
    assert error.max() <= math.sqrt(3) * 0.005 + 1e-5


def test_sh0_streams_that_break_the_rules_are_refused():
    values = np.random.default_rng(11).normal(size=(9, 3)).astype(f32)
    good_one = sh0_transform.write(values, np.eye(3, dtype=f32), fit(values, 0.1))

    def broken(**changes):
        with pytest.raises(FormatError, match="chunk 7") as caught:
            decode(changed(good_one, **changes))
        return caught.value.code, caught.value.clause

    decode(good_one)
    for value in (math.nan, math.inf, 1.0000002, -1.0000002, 1e30):
        for place in (36, 68):
            data = good_one.params[:place] + struct.pack("<f", value) + good_one.params[place + 4 :]
            assert broken(params=data) == ("basis-value", "6.13")
    for params in (b"", good_one.params[:36], good_one.params[:-1], good_one.params + b"\0"):
        assert broken(params=params) == ("stream-params", "6.2")
    for planes in (good_one.planes[:-1], [*good_one.planes, good_one.planes[0]]):
        assert broken(planes=planes) == ("stream-planes", "6.2")
    planes = [plane.copy() for plane in good_one.planes]
    planes[1][0] = grids.unpack(memoryview(good_one.params), 3, "here").levels[1]
    assert broken(planes=planes) == ("code-range", "6.4")
    for attribute in (Attribute.MEANS, Attribute.SCALES, Attribute.OPACITIES):
        with pytest.raises(FormatError) as caught:
            decode(changed(good_one, attribute=attribute))
        assert caught.value.code == "stream-kind"
