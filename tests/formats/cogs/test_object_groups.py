"""Which segments share an object, and which the objects of a folder hold already."""

from pathlib import Path

import pytest
from cogs_samples import file_of

import cogsplat
from cogsplat.formats.cogs.folder_places import key_of, object_name
from cogsplat.formats.cogs.folder_writer import unpack_cogs
from cogsplat.formats.cogs.layout import CODEBOOK_KINDS
from cogsplat.formats.cogs.object_groups import StoredSegments, group_segments, has_object


@pytest.mark.parametrize("profile", ["vq", "transform"])
def test_a_chunk_is_one_object_and_so_are_codebooks(profile: str) -> None:
    with cogsplat.open(file_of(profile, 6000, 3, 500)) as file:
        groups = group_segments(file.segments)
        assert sorted(row for rows in groups for row in rows) == [*range(len(file.segments))]
        assert all(rows == sorted(rows) for rows in groups)
        of_row = {row: number for number, rows in enumerate(groups) for row in rows}
        for chunk in range(file.num_chunks):
            rows = file.chunk_rows(chunk)
            parts = [rows.head, rows.refinement, rows.tail, rows.attributes]
            assert len({of_row[row] for row in parts if row is not None}) == 1
        books = [row for row, kind in enumerate(file.segments.kind) if kind in CODEBOOK_KINDS]
        assert len({of_row[row] for row in books}) == (1 if books else 0)
        chunks = {of_row[file.chunk_rows(chunk).head] for chunk in range(file.num_chunks)}
        assert len(chunks) == file.num_chunks


def test_only_whole_objects_are_shared(tmp_path: Path) -> None:
    with cogsplat.open(file_of("vq")) as file:
        unpack_cogs(file, tmp_path)
        row = file.chunk_rows(2).head
        key, length = file.segments.hash[row].tobytes(), int(file.segments.length[row])
        content = bytes(file.read_segment(row))
    (place,) = StoredSegments(tmp_path).places_of([key])
    assert place is not None
    path = tmp_path / object_name(place.key)
    data = path.read_bytes()
    assert data[place.offset : place.offset + length] == content
    assert len(data) == place.size
    assert has_object(tmp_path, place.key, place.size)
    assert not has_object(tmp_path, place.key, place.size + 1)
    assert not has_object(tmp_path, key_of(b"nothing"), 7)
    path.write_bytes(bytes(len(data)))
    assert StoredSegments(tmp_path).places_of([key, bytes(16)]) == [None, None]
