"""Scenes that hypothesis makes: few splats, values of any size that formats may meet."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from cogsplat.codec.splats import SceneInfo, Splats, sh_coefficients

_F32 = np.float32


def _values(
    shape: tuple[int, ...], least: float, most: float
) -> st.SearchStrategy[NDArray[np.float32]]:
    numbers = st.floats(float(_F32(least)), float(_F32(most)), width=32)
    return arrays(_F32, shape, elements=numbers)


@st.composite
def made_scenes(draw: st.DrawFn, least_rows: int = 0, most_rows: int = 9) -> Splats:
    """Return a scene that can be drawn: finite values, quaternions that are not zero."""
    rows, degree = draw(st.integers(least_rows, most_rows)), draw(st.integers(0, 3))
    quats = draw(_values((rows, 4), -2, 2))
    # A rotation of no length is none.
    quats[np.abs(quats).max(axis=1, initial=0) < 1e-3] = (1, 0, 0, 0)
    extent = draw(st.sampled_from([1e-3, 1.0, 50.0, 1e4]))
    return Splats(
        means=draw(_values((rows, 3), -extent, extent)),
        scales=draw(_values((rows, 3), -14, 6)),
        quats=quats,
        opacities=draw(_values((rows,), -16, 16)),
        sh0=draw(_values((rows, 3), -4, 4)),
        shN=draw(_values((rows, sh_coefficients(degree) - 1, 3), -2, 2)),
        info=SceneInfo(
            origin=draw(st.sampled_from([(0.0, 0.0, 0.0), (1e6, -5.0, 0.25)])),
            antialiased=draw(st.booleans()),
        ),
    )
