"""What tests of every package share."""

from collections.abc import Iterator

import pytest
from hypothesis import settings

from cogsplat.codec.streams import compiled

# The same examples on every run and every machine, none refused for being slow on a busy one, and
# no folder of failures left in the checkout.
settings.register_profile("cogsplat", derandomize=True, deadline=None, database=None)
settings.load_profile("cogsplat")


@pytest.fixture(scope="module", params=["numpy", "compiled"])
def kernels(request: pytest.FixtureRequest) -> Iterator[str]:
    """Decode with numpy alone, then with the compiled kernels: both must do the same."""
    way: str = request.param
    before = compiled.ready()
    patch = pytest.MonkeyPatch()
    if way == "numpy":
        patch.setattr(compiled, "_load", lambda: None)
    elif not compiled._load():
        pytest.skip("numba is not here")
    compiled.use(way == "compiled")
    yield way
    compiled.use(before)
    patch.undo()
