import pytest
from cogs_samples import file_of

from cogsplat.codec.segments.attributes import AttributeType
from cogsplat.formats.cogs.decoded_rows import allocate, row_bytes
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource


@pytest.mark.parametrize("degree", range(4))
def test_the_bytes_of_a_row_are_those_that_are_allocated(degree):
    kinds = [AttributeType("object", "u2", 1), AttributeType("normal", "f4", 3)]
    with open_cogs(BytesSource(file_of("transform"))) as file:
        root = file.root
    for some in ([], kinds):
        rows = allocate(70, degree, root, some)
        assert rows.nbytes == 70 * row_bytes(degree, some)
        assert rows.sh_degree == degree
        assert rows.info == root.info
        assert list(rows.extras) == [kind.name for kind in some]
