import io
import os
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from cogsplat.codec.errors import StorageError, TruncatedError
from cogsplat.formats.storage.source import (
    BytesSource,
    FileSource,
    PrefixSource,
    StreamSource,
    as_source,
)

DATA = bytes(range(256)) * 40


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "data.bin"
    path.write_bytes(DATA)
    return path


@pytest.fixture(params=["bytes", "file", "prefix"])
def source(request, path):
    made = {
        "bytes": lambda: BytesSource(DATA),
        "file": lambda: FileSource(path),
        "prefix": lambda: PrefixSource(BytesSource(DATA + b"more"), len(DATA)),
    }[request.param]()
    yield made
    made.close()


def test_ranges_are_what_was_asked_for(source):
    assert source.size == len(DATA)
    for offset, length in [(0, 0), (0, 10), (255, 3), (len(DATA), 0), (0, len(DATA))]:
        data = source.read(offset, length)
        assert isinstance(data, bytes)
        assert data == DATA[offset : offset + length]


@pytest.mark.parametrize(("offset", "length"), [(len(DATA) - 1, 2), (1 << 60, 1), (0, 1 << 60)])
def test_reading_past_the_end_is_a_truncation(source, offset, length):
    with pytest.raises(TruncatedError) as caught:
        source.read(offset, length)
    assert caught.value.code == "file-truncated"
    assert caught.value.needed == offset + length
    assert str(len(DATA)) in caught.value.message


@pytest.mark.parametrize(("offset", "length"), [(-1, 1), (0, -1)])
def test_negative_ranges_are_misuse(source, offset, length):
    with pytest.raises(ValueError, match="negative"):
        source.read(offset, length)


def test_a_prefix_is_no_longer_than_its_source():
    assert PrefixSource(BytesSource(DATA), 1 << 60).size == len(DATA)
    assert PrefixSource(BytesSource(DATA), 7).read(0, 7) == DATA[:7]
    with pytest.raises(TruncatedError):
        PrefixSource(BytesSource(DATA), 7).read(0, 8)


def test_a_prefix_of_fewer_than_no_bytes_is_empty():
    source = PrefixSource(BytesSource(DATA), 0)
    assert (source.size, source.read(0, 0)) == (0, b"")


def test_a_file_cut_while_it_is_read_is_named(path):
    source = FileSource(path)
    os.truncate(path, 100)
    assert source.read(0, 100) == DATA[:100]
    with pytest.raises(TruncatedError) as caught:
        source.read(90, 20)
    assert caught.value.code == "source-changed"
    assert caught.value.offset == 90
    source.close()


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(StorageError) as caught:
        FileSource(tmp_path / "nothing")
    assert caught.value.code == "not-found"


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(StorageError):
        FileSource(tmp_path)


def test_threads_read_their_own_ranges(path):
    source = FileSource(path)
    start = threading.Barrier(4)

    def read(worker):
        start.wait(10)
        offsets = range(worker, len(DATA) - 16, 97)
        return all(source.read(o, 16) == DATA[o : o + 16] for o in offsets)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(read, range(4)))
    source.close()


class Dribble(io.BytesIO):
    """A stream that gives three bytes at a time."""

    def read(self, size=-1):
        return super().read(min(size, 3) if size >= 0 else 3)


def test_streams_are_read_by_range():
    data = bytes(range(100))
    for stream in (io.BytesIO(data), Dribble(data)):
        source = StreamSource(stream)
        assert source.size == 100
        assert source.read(10, 20) == data[10:30]
        assert source.read(0, 0) == b""
        with pytest.raises(TruncatedError):
            source.read(90, 20)
        source.close()
        assert not stream.closed


def test_a_stream_that_becomes_shorter_is_said():
    stream = io.BytesIO(bytes(50))
    source = StreamSource(stream)
    stream.truncate(20)
    with pytest.raises(TruncatedError) as caught:
        source.read(10, 30)
    assert caught.value.code == "source-changed"


def test_a_pipe_is_refused():
    class Pipe(io.RawIOBase):
        def seekable(self):
            return False

    with pytest.raises(StorageError) as caught:
        StreamSource(Pipe())
    assert caught.value.code == "not-seekable"


def test_sources_are_made_of_what_is_given(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"abc")
    own = BytesSource(b"abc")
    with path.open("rb") as stream:
        for given in (path, str(path), b"abc", bytearray(b"abc"), memoryview(b"abc"), stream, own):
            source = as_source(given)
            assert source.read(0, 3) == b"abc"
            if given is not own:
                source.close()
    assert as_source(own) is own
    with pytest.raises(TypeError, match="a int, expected a path"):
        as_source(5)
