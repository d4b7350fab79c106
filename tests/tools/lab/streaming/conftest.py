"""A small house that is cut by cells."""

from collections.abc import Iterator
from pathlib import Path

import pytest

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.streaming.comparison import Simulation
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms


@pytest.fixture(scope="session")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("house") / "house.cogs"
    config = EncodeConfig(
        cells=True, chunk_splats=128, order="contribution", view_table=False, compensate=False
    )
    cameras = rooms_cameras(4, views=2)
    cogsplat.encode(synth_rooms(4, 5000, sh_degree=1), path, cameras=cameras, config=config)
    return path


@pytest.fixture
def house_file(house: Path) -> Iterator[CogsFile]:
    with cogsplat.open(house) as file:
        yield file


@pytest.fixture
def simulation(house_file: CogsFile) -> Simulation:
    """Clients of the house, with contributions known in small pictures."""
    known = [camera.downscaled(8) for camera in rooms_cameras(4, views=4)]
    return Simulation(house_file, known, threads=1)
