import sys

import numba
import pytest

import cogsplat.codec.streams as streams
from cogsplat.codec.streams import decoding_tiers


class Loader:
    """Counts the calls of `start`."""

    def __init__(self):
        self.starts = 0

    def start(self):
        self.starts += 1


@pytest.mark.parametrize(
    ("loaded", "decoded", "expected"),
    [
        (True, [1], 1),
        (False, [1], 0),
        (False, [decoding_tiers.MIN_SPLATS - 1], 0),
        (False, [decoding_tiers.MIN_SPLATS], 1),
        (False, [1, decoding_tiers.MIN_SPLATS_REPEATED - 2], 0),
        (False, [1, decoding_tiers.MIN_SPLATS_REPEATED - 1], 1),
    ],
)
def test_kernels_are_loaded_with_numba_or_for_many_splats(loaded, decoded, expected, monkeypatch):
    loader = Loader()
    monkeypatch.setattr(decoding_tiers, "LOADER", loader)
    for name, value in (("_decided", False), ("_splats_begun", 0), ("_chunk_reader", None)):
        monkeypatch.setattr(decoding_tiers, name, value)
    monkeypatch.setitem(sys.modules, "numba", numba if loaded else None)
    for splats in decoded:
        decoding_tiers.load_if_worthwhile(splats)
    assert loader.starts == expected
    for wanted in (False, True):
        decoding_tiers.use_compiled(wanted)
        decoding_tiers.load_if_worthwhile(decoding_tiers.MIN_SPLATS)
        decoding_tiers._switch_to_compiled()
        assert loader.starts == expected
        assert decoding_tiers.is_compiled() is wanted


def test_numpy_decodes_without_numba(monkeypatch):
    for name in ("_decided", "_chunk_reader"):
        monkeypatch.setattr(decoding_tiers, name, getattr(decoding_tiers, name))
    monkeypatch.setitem(sys.modules, "numba", None)
    for name in [n for n in sys.modules if n.startswith("cogsplat.codec.streams.kernels")]:
        monkeypatch.delitem(sys.modules, name)
        monkeypatch.delattr(streams, name.rpartition(".")[2])
    assert not decoding_tiers.use_compiled(True)
    assert not decoding_tiers.is_compiled()
