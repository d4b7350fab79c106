"""Segments that a source lacks within its size."""

import pytest
from cogs_samples import file_of

from cogsplat.codec.errors import TruncatedError
from cogsplat.formats.cogs.missing_segments import missing_segment_bytes, require_all_segments
from cogsplat.formats.cogs.scene_index import read_scene_index
from cogsplat.formats.storage.source import BytesSource


class Holed(BytesSource):
    """A source that says it lacks what begins at some bytes."""

    def __init__(self, data: bytes, holes: set[int]) -> None:
        super().__init__(data)
        self._holes = holes

    def holds(self, offset: int, length: int) -> bool:
        return offset not in self._holes


def test_gaps_are_counted_and_refused() -> None:
    data = file_of("vq")
    plain = BytesSource(data)
    index = read_scene_index(plain, partial=False)
    assert missing_segment_bytes(plain, index) == 0
    require_all_segments(plain, index)
    source = Holed(data, {int(index.offsets[2]), int(index.offsets[5])})
    assert missing_segment_bytes(source, index) == index.segments.length[[2, 5]].sum()
    with pytest.raises(TruncatedError, match=f"2 of {len(index.segments)}") as refused:
        require_all_segments(source, index)
    assert refused.value.message.startswith(f"bytes: 2 of {len(index.segments)} segments")
    assert f"at byte {index.offsets[2]}" in refused.value.message
    assert refused.value.code == "segment-missing"
