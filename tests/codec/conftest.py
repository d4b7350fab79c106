import importlib
from collections.abc import Iterator

import pytest

from cogsplat.codec.streams import compiled


@pytest.fixture(scope="module", params=["numpy", "compiled"])
def arithmetic(request: pytest.FixtureRequest) -> Iterator[str]:
    """Run a module's tests through both ways of decoding, which give the same bits."""
    before = compiled.ready()
    if request.param == "compiled":
        pytest.importorskip("numba")
        importlib.import_module("cogsplat.codec.streams.kernels")
    compiled.use(request.param == "compiled")
    yield request.param
    compiled.use(before)
