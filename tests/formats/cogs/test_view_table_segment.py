import numpy as np
import pytest

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.errors import FormatError, LimitError, TruncatedError
from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.verification import checks
from cogsplat.formats.cogs.view_table_segment import pack_view_table, unpack_view_table
from cogsplat.formats.storage.limits import Limits
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras


def made(views=5, chunks=9):
    rng = np.random.default_rng(3)
    return ViewTable(
        rng.normal(size=(views, 3)).astype(np.float32),
        rng.integers(0, 256, (views, chunks), np.uint8),
    )


def test_a_table_comes_back():
    table = made()
    found = unpack_view_table(pack_view_table(table), "here", 9, 1000)
    for name in ("positions", "codes"):
        np.testing.assert_array_equal(getattr(found, name), getattr(table, name))
        assert getattr(found, name).dtype == getattr(table, name).dtype


def test_codes_count_against_the_limit():
    with pytest.raises(LimitError, match="45 codes") as caught:
        unpack_view_table(pack_view_table(made()), "here", 9, 44)
    assert caught.value.code == "decoded-size"


def test_a_table_of_other_chunks_is_refused():
    with pytest.raises(FormatError) as caught:
        unpack_view_table(pack_view_table(made()), "here", 10, 1000)
    assert caught.value.code in ("plane-length", "zstd-size")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    out = tmp_path_factory.mktemp("table") / "cells.cogs"
    config = EncodeConfig(order="contribution", cells=True, chunk_splats=256, compensate=False)
    cameras = [camera.downscaled(4) for camera in rooms_cameras(4, views=3)]
    cogsplat.encode(synth_rooms(4, 8000, sh_degree=1), out, cameras=cameras, config=config)
    return out


def test_a_file_has_it_where_clients_begin_to_choose(path, tmp_path):
    with cogsplat.open(path) as file:
        table = file.view_table()
        row = file.view_table_rows[()]
        assert table is not None
        assert table.codes.shape == (len(table.positions), file.num_chunks)
        kinds, owners = file.segments.kind, file.segments.owner
        assert kinds[row + 1] == SegmentKind.HEAD
        cells = file.chunks.cell
        assert cells[owners[row + 1]] > 1
        assert (cells[: owners[row + 1]] == 1).all()
        offset = int(file.offsets[row])
        assert "view table of index ()" in [check.what for check in checks(file)]
    part = tmp_path / "part.cogs"
    part.write_bytes(path.read_bytes()[: offset + 10])
    with cogsplat.open(part, partial=True) as file, pytest.raises(TruncatedError):
        file.view_table()
    limits = Limits(decoded_bytes=20)
    with cogsplat.open(path, limits=limits) as file, pytest.raises(LimitError):
        file.view_table()


def test_files_without_one_say_so(tmp_path):
    out = tmp_path / "plain.cogs"
    config = EncodeConfig(order="contribution", compensate=False)
    cogsplat.encode(synth(500), out, cameras=synth_cameras(3), config=config)
    with cogsplat.open(out) as file:
        assert file.view_table() is None
        assert not file.view_table_rows
