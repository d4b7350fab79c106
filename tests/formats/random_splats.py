"""Random scenes for tests of scene formats."""

import numpy as np

from cogsplat.codec.splats import SceneInfo, Splats


def random_splats(
    count: int, rest: int = 15, info: SceneInfo | None = None, *, sh_scale: float = 0.25
) -> Splats:
    """Return splats of usual sizes and opacities, the same ones for the same arguments.

    Parameters
    ----------
    count : int
        Splats.
    rest : int
        SH coefficients above DC of each channel.
    info : SceneInfo, optional
    sh_scale : float
        Standard deviation of these coefficients.
    """
    rng = np.random.default_rng(count + rest)

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    return Splats(
        means=draw(count, 3) * np.float32(5),
        scales=draw(count, 3) - 4,
        quats=draw(count, 4),
        opacities=draw(count) * np.float32(3),
        sh0=draw(count, 3),
        shN=draw(count, rest, 3) * np.float32(sh_scale),
        info=info or SceneInfo(),
    )
