"""What tests of every package share."""

from collections.abc import Iterator

import pytest

from cogsplat.codec.streams import compiled


@pytest.fixture(scope="module", params=["numpy", "compiled"])
def kernels(request: pytest.FixtureRequest) -> Iterator[str]:
    """Decode with numpy alone, then with the compiled kernels: both must do the same."""
    way: str = request.param
    before = compiled.ready()
    patch = pytest.MonkeyPatch()
    if way == "numpy":
        patch.setattr(compiled, "_load", lambda: False)
    elif not compiled._load():
        pytest.skip("numba is not here")
    compiled.use(way == "compiled")
    yield way
    compiled.use(before)
    patch.undo()
