"""What a COGS scene is read from."""

import io
from pathlib import Path

import pytest
from cogs_samples import file_of

import cogsplat
from cogsplat.codec.errors import FormatError, StorageError
from cogsplat.formats.cogs.folder_source import FolderSource
from cogsplat.formats.cogs.folder_writer import unpack_cogs
from cogsplat.formats.cogs.sources import cogs_source
from cogsplat.formats.storage.source import BytesSource, FileSource


def test_paths_are_files_folders_or_manifests(tmp_path: Path) -> None:
    data = file_of("vq")
    path, folder = tmp_path / "a.cogs", tmp_path / "a"
    path.write_bytes(data)
    with cogsplat.open(path) as file:
        unpack_cogs(file, folder)
    for given, kind in {
        path: FileSource,
        folder: FolderSource,
        folder / "manifest.cogsm": FolderSource,
    }.items():
        for form in (given, str(given)):
            source = cogs_source(form)
            assert isinstance(source, kind)
            assert source.size == len(data)
            source.close()
    own = BytesSource(data)
    assert cogs_source(own) is own
    assert cogs_source(io.BytesIO(data)).read(0, 8) == data[:8]


def test_folders_without_a_manifest_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError) as refused:
        cogs_source(tmp_path)
    assert refused.value.code == "not-found"
    (tmp_path / "manifest.cogsm").write_bytes(b"ply" + bytes(100))
    with pytest.raises(FormatError, match="a PLY file") as broken:
        cogs_source(tmp_path)
    assert broken.value.code == "not-cogs"
