"""`cogsplat.unpack` and `cogsplat.pack`: the same bytes back, from disk, memory and the network."""

from pathlib import Path

import pytest
from cogs_samples import file_of
from fault_server import Exchange, FaultServer, right, serving

import cogsplat
from cogsplat.codec.errors import Cancelled, FormatError, StorageError

DATA = file_of("vq")


def test_a_folder_becomes_the_file_it_was(scene: Path, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    folder = str(tmp_path / "new" / "scene")
    done = cogsplat.unpack(str(scene), folder, progress=lambda *step: told.append(step))
    assert isinstance(done, cogsplat.Unpacked)
    assert done.manifest == Path(folder, "manifest.cogsm")
    assert told[-1] == ("unpack", done.segments, done.segments)
    told.clear()
    size = cogsplat.pack(folder, str(tmp_path / "b"), progress=lambda *step: told.append(step))
    assert size == len(DATA)
    assert (tmp_path / "b").read_bytes() == DATA
    assert told[-1] == ("pack", done.segments, done.segments)


def test_versions_share_a_folder_and_nothing_is_replaced_unasked(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    first = cogsplat.unpack(DATA, folder)
    second = cogsplat.unpack(DATA, folder, name="second.cogsm")
    assert (second.written, second.shared) == (0, first.written)
    with pytest.raises(StorageError) as there:
        cogsplat.unpack(DATA, folder, name="second.cogsm")
    assert there.value.code == "exists"
    cogsplat.unpack(DATA, folder, name="second.cogsm", force=True)
    assert cogsplat.pack(folder / "second.cogsm", tmp_path / "b") == len(DATA)
    with pytest.raises(StorageError) as again:
        cogsplat.pack(folder, tmp_path / "b")
    assert again.value.code == "exists"
    cogsplat.pack(folder, tmp_path / "b", force=True)
    with pytest.raises(ValueError, match="expected a file name"):
        cogsplat.unpack(DATA, folder, name="../a.cogsm")


@pytest.mark.parametrize("given", [".", "manifest.cogsm"])
def test_no_file_of_the_folder_is_written_over(tmp_path: Path, given: str) -> None:
    cogsplat.unpack(DATA, tmp_path)
    for target in (tmp_path / "manifest.cogsm", next((tmp_path / "segments").rglob("*.bin"))):
        kept = target.read_bytes()
        with pytest.raises(StorageError) as caught:
            cogsplat.pack(tmp_path / given, target, force=True)
        assert caught.value.code == "output-is-input"
        assert target.read_bytes() == kept


def test_parts_are_taken_where_they_may_be(tmp_path: Path) -> None:
    part = DATA[: len(DATA) * 3 // 4]
    with pytest.raises(FormatError) as caught:
        cogsplat.unpack(part, tmp_path / "scene")
    assert caught.value.code == "file-truncated"
    assert not (tmp_path / "scene").exists()
    cogsplat.unpack(part, tmp_path / "scene", partial=True)
    size = cogsplat.pack(tmp_path / "scene", tmp_path / "b", partial=True)
    assert 0 < size <= len(part)
    assert (tmp_path / "b").read_bytes() == DATA[:size]


def test_what_is_stopped_leaves_no_file(scene: Path, tmp_path: Path) -> None:
    def stop(stage: str, done: int, total: int) -> None:
        raise Cancelled(stage)

    with pytest.raises(Cancelled):
        cogsplat.unpack(scene, tmp_path / "scene", progress=stop)
    assert list((tmp_path / "scene").glob("*.cogsm")) == []
    cogsplat.unpack(scene, tmp_path / "scene")
    with pytest.raises(Cancelled):
        cogsplat.pack(tmp_path / "scene", tmp_path / "b", progress=stop)
    assert not (tmp_path / "b").exists()


def test_a_file_that_changes_on_the_network_is_read_anew(tmp_path: Path) -> None:
    large, other = file_of("vq", 6000, 3, 500), file_of("vq", 6000, 3, 600)
    # What is left behind the first request is asked for of the other file.
    assert len(large) > 65536

    async def replaced(exchange: Exchange) -> None:
        server.data, server.etag = other, '"two"'
        await right(exchange)

    with serving(FaultServer(large, [right, replaced])) as server:
        cogsplat.unpack(server.url(), tmp_path / "scene")
    cogsplat.pack(tmp_path / "scene", tmp_path / "b")
    assert (tmp_path / "b").read_bytes() == other
