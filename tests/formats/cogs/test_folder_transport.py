"""Objects of a folder by addresses: ranges, whole ones that are kept, and what is refused."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from cogsplat.codec.errors import CogsplatError, FormatError, StorageError, TruncatedError
from cogsplat.formats.cogs.folder_map import FolderMap, ObjectRange
from cogsplat.formats.cogs.folder_transport import FolderTransport, address_of
from cogsplat.formats.network.backoff import TransientError
from cogsplat.formats.network.range_responses import RangeResponse, ResponseHead
from cogsplat.tools.lab.conformance.reference_folders import MANIFEST, folder_of_file

PAGED = Path(__file__).resolve().parents[2] / "vectors" / "valid" / "pages.cogs"
OBJECT = ObjectRange("segments/a.bin", 100, 200, 1000)
CONTENT = bytes(range(250)) * 4


class Memory:
    """A transport of objects in memory, which counts what is asked of it."""

    def __init__(self, objects: dict[str, bytes], *, ranges: bool, name: str = MANIFEST) -> None:
        self.objects, self.ranges, self.name = objects, ranges, name
        self.asked: list[tuple[str, int, int]] = []
        self.cut = 0

    def sibling(self, name: str) -> "Memory":
        made = Memory(self.objects, ranges=self.ranges, name=name)
        made.asked, made.cut = self.asked, self.cut
        return made

    @asynccontextmanager
    async def get(
        self, first: int, end: int, *, bypass_caches: bool = False
    ) -> AsyncIterator[RangeResponse]:
        self.asked.append((self.name, first, end))
        if self.name not in self.objects:
            raise StorageError("not-found", self.name)
        data = self.objects[self.name]
        stated = ResponseHead(first, end, len(data), None, is_whole=False)
        if not self.ranges:
            stated, first, end = (
                ResponseHead(0, len(data), len(data), None, is_whole=True),
                0,
                len(data),
            )

        async def parts() -> AsyncIterator[bytes]:
            for at in range(first, end - self.cut, 64):
                yield data[at : min(at + 64, end - self.cut)]

        yield RangeResponse(stated, parts())

    async def close(self) -> None:
        self.asked.append(("closed", 0, 0))


@pytest.fixture
def folder(samples: dict[str, bytes]) -> FolderMap:
    return FolderMap(samples[MANIFEST], "folder")


@pytest.fixture
def samples() -> dict[str, bytes]:
    return folder_of_file(PAGED.read_bytes()) | {OBJECT.name: CONTENT}


def got(transport: FolderTransport, first: int, end: int) -> bytes:
    async def run() -> bytes:
        async with transport.get(first, end) as answer:
            assert not answer.head.is_whole
            assert answer.head.first == first
            return b"".join([part async for part in answer.parts])

    return asyncio.run(run())


@pytest.mark.parametrize("ranges", [True, False])
def test_ranges_of_objects_are_got(
    folder: FolderMap, samples: dict[str, bytes], ranges: bool
) -> None:
    memory = Memory(samples, ranges=ranges)
    transport = FolderTransport(memory, folder, samples[MANIFEST])
    number = transport.number_of(OBJECT)
    assert number == transport.number_of(OBJECT) == 1
    first = address_of(number, OBJECT.offset)
    assert got(transport, first, first + 200) == CONTENT[100:300]
    assert got(transport, first + 500, first + 5000) == CONTENT[600:]
    # The manifest is asked of nobody.
    assert got(transport, 0, folder.manifest_bytes) == samples[MANIFEST]
    asked = [(OBJECT.name, 100, 300), (OBJECT.name, 600, 1000)]
    # From a server without ranges an object comes once.
    assert memory.asked == (asked if ranges else asked[:1])
    assert transport.requests == len(memory.asked)
    assert transport.received_bytes == (200 + 400 if ranges else len(CONTENT))
    asyncio.run(transport.close())
    assert memory.asked[-1] == ("closed", 0, 0)


@pytest.mark.parametrize("ranges", [True, False])
def test_what_is_not_as_stated_is_refused(
    folder: FolderMap, samples: dict[str, bytes], ranges: bool
) -> None:
    def refused(objects: dict[str, bytes], piece: ObjectRange) -> CogsplatError:
        transport = FolderTransport(Memory(objects, ranges=ranges), folder, b"")
        first = address_of(transport.number_of(piece), piece.offset)
        with pytest.raises(CogsplatError) as error:
            got(transport, first, first + piece.length)
        return error.value

    missing = refused({}, OBJECT)
    assert isinstance(missing, TruncatedError)
    assert missing.code == "segment-missing"
    longer = refused({OBJECT.name: CONTENT + b"x"}, OBJECT)
    assert isinstance(longer, FormatError)
    assert (longer.code, OBJECT.name in longer.message) == ("segment-object", True)
    manifest = ObjectRange("", 0, 64, folder.manifest_bytes)
    assert refused({}, manifest).code == "not-found"
    assert refused({MANIFEST: samples[MANIFEST][:-1]}, manifest).code == "file-truncated"


def test_a_whole_object_that_breaks_off_is_asked_for_again(
    folder: FolderMap, samples: dict[str, bytes]
) -> None:
    memory = Memory(samples, ranges=False)
    memory.cut = 10
    transport = FolderTransport(memory, folder, b"")
    first = address_of(transport.number_of(OBJECT), 0)
    with pytest.raises(TransientError) as fault:
        got(transport, first, first + 10)
    assert fault.value.code == "connection-broken"
    memory.cut = 0
    assert got(transport, first, first + 10) == CONTENT[:10]
