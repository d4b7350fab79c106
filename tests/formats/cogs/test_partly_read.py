"""Files whose last pages are missing: chunks are numbered as in the whole file."""

import numpy as np
import pytest
from fault_server import FaultServer, serving

import cogsplat
from cogsplat.codec.errors import TruncatedError
from cogsplat.formats.cogs.between_levels import decode_between
from cogsplat.formats.cogs.known_chunks import known_chunks
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.conformance import (
    compensation_vectors,
    level_vectors,
    reference_compensation,
)


def vector(name):
    found = {v.name: v.data for v in [*compensation_vectors.valid(), *level_vectors.valid()]}
    return found[name]


def before_pages(data):
    """Return the beginnings of a file, each up to one of the pages that its root lists."""
    with open_cogs(BytesSource(data)) as file:
        return [data[: page.start] for page in file.indices[0].pages()]


def expected(file, stored, chosen):
    """Return scales and opacities by SPEC 8.5, where an unread page counts as one chunk."""
    known = known_chunks(file._index)
    sizes, above = known.splats.tolist(), [None if x < 0 else x for x in known.parents.tolist()]
    payloads = [bytes(file.read_segment(row)) for row in file._index.layers]
    payloads = payloads[: len(file.compensation().layers)]
    starts = np.cumsum([0, *sizes])
    pieces = []
    for chunk in chosen:
        shifts = reference_compensation.set_shifts(payloads, sizes, above, chosen, chunk)
        if not file.chunks.cell.all():
            shifts = reference_compensation.shifts(payloads, sizes, len(chosen))
        own = slice(starts[chunk], starts[chunk + 1])
        pieces += [(0, 0)] * sizes[chunk] if shifts is None else shifts[own]
    added = np.array(pieces, np.float32)
    return stored.scales + added[:, :1], stored.opacities + added[:, 1]


@pytest.mark.parametrize("name", ["compensation-pages", "compensation-cells-pages"])
def test_sets_of_chunks_are_compensated_without_the_missing_pages(name):
    sets = 0
    for data in before_pages(vector(name)):
        with open_cogs(BytesSource(data), partial=True) as file:
            known = range(file.num_chunks)
            above = [None if x < 0 else x for x in file.parents().tolist()]
            chosen = [list(range(count + 1)) for count in known]
            if file.chunks.cell.all():
                chosen += reference_compensation.closed_sets(above)
            for chunks in chosen:
                found, stored = file.decode(chunks, compensate=True), file.decode(chunks)
                scales, opacities = expected(file, stored, chunks)
                np.testing.assert_array_equal(found.scales, scales)
                np.testing.assert_array_equal(found.opacities, opacities)
                sets += 1
    assert sets > 3


def test_compensation_over_a_network_reads_the_pages_it_counts():
    data = vector("compensation-cells-pages")
    whole = cogsplat.open(data)
    with serving(FaultServer(data)) as server:
        for chunks in ([0], [0, 1, 2, 3], [0, 1, 2, 5]):
            with cogsplat.open(server.url()) as file:
                file.decode(chunks)
                found = file.decode(chunks, compensate=True)
            np.testing.assert_array_equal(
                found.scales, whole.decode(chunks, compensate=True).scales
            )


def test_a_level_of_a_missing_page_is_refused():
    (first, second) = before_pages(vector("levels-pages"))
    for data, there in ((first, 1), (second, 2)):
        with open_cogs(BytesSource(data), partial=True) as file:
            for level in range(there):
                assert len(file.decode(level=level)) > 0
            for level in range(there, 3):
                with pytest.raises(TruncatedError, match="the page of chunk"):
                    file.decode(level=level)
            with pytest.raises(TruncatedError, match="the page of chunk"):
                decode_between(file, there - 0.5)
