"""What sources of folders have in common, on one whose objects are in memory."""

from pathlib import Path

import pytest

from cogsplat.formats.cogs.folder_map import FolderMap, ObjectRange
from cogsplat.formats.cogs.folder_places import object_name
from cogsplat.formats.cogs.folder_source import FolderSource
from cogsplat.formats.cogs.network_folder import NetworkFolder
from cogsplat.formats.cogs.object_source import ObjectSource
from cogsplat.tools.lab.conformance.reference_folders import MANIFEST, folder_of_file

VALID = Path(__file__).resolve().parents[2] / "vectors" / "valid"


class Objects(ObjectSource):
    """Adds pages as a range asks for them."""

    def __init__(self, objects: dict[str, bytes]) -> None:
        super().__init__(FolderMap(objects[MANIFEST], "objects"))
        self._content = objects

    def _object_bytes(self, piece: ObjectRange) -> bytes:
        return self._content[piece.name][piece.offset : piece.offset + piece.length]


@pytest.mark.parametrize("name", ["empty", "one-splat", "pages", "pictures-pages"])
def test_all_that_lies_beside_a_manifest_is_named_and_read(name: str) -> None:
    data = (VALID / f"{name}.cogs").read_bytes()
    objects = folder_of_file(data)
    source = Objects(objects)
    assert source.size == len(data)
    # Behind the preamble and the root: nothing of that is in an object.
    assert (
        data[64 : source.first_request_bytes] == objects[MANIFEST][64 : source.first_request_bytes]
    )
    # Only the root is known yet: pages are added when all is asked for.
    sizes = {other: len(content) for other, content in objects.items() if other != MANIFEST}
    assert source.objects() == sizes
    assert all(source.read_object(other) == objects[other] for other in sizes)
    named = {
        object_name(key.tobytes())
        for segments in source.placed_segments()
        for key in segments.places.objects
    }
    assert named | source.page_objects().keys() == sizes.keys()


def test_folders_on_disk_and_on_networks_are_such_sources() -> None:
    assert issubclass(FolderSource, ObjectSource)
    assert issubclass(NetworkFolder, ObjectSource)
