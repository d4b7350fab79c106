import pytest

from cogsplat.codec.streams import compiled, whole_chunk


@pytest.fixture
def without_kernels():
    before = compiled.ready()
    compiled.use(False)
    yield
    compiled.use(before)


def test_nothing_is_read_whole_without_kernels(without_kernels):
    def basis_of(number):
        raise AssertionError("nothing was to be read")

    assert compiled.chunk_reader() is None
    assert whole_chunk.read(memoryview(b""), None, None, basis_of, None) is False
