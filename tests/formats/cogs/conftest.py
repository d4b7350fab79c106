from pathlib import Path

import pytest
from cogs_samples import file_of


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A file of random splats in several chunks, with codebooks."""
    path = tmp_path / "scene.cogs"
    path.write_bytes(file_of("vq"))
    return path
