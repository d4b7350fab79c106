import numpy as np
import pytest
from cogs_samples import encoded, file_of, scene
from encoding import encode, unseen

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import StorageError
from cogsplat.codec.geometry.bounds import box
from cogsplat.codec.views.first_look import FirstLook
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.cogs.layout import COLOUR_BANDS, SegmentKind
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.writer import lay_out
from cogsplat.formats.storage.source import BytesSource, FileSource

PROFILES = ("transform", "vq", "near-lossless")


@pytest.mark.parametrize("profile", PROFILES)
def test_a_scene_comes_back_in_its_own_order(tmp_path, profile):
    made = encoded(profile)
    size = cogs.save(made, tmp_path / "a.cogs", writer="tests 1.0")
    assert size == (tmp_path / "a.cogs").stat().st_size
    with open_cogs(FileSource(tmp_path / "a.cogs")) as file:
        file.verify()
        assert file.root.writer == "tests 1.0"
        assert file.root.first_view is None
        assert len(file.decode()) == made.splats
        assert file.chunks.contribution.tolist() == [c.contribution for c in made.chunks]
        assert file.root.info == made.scene.info


def test_a_file_is_not_replaced_unasked(tmp_path):
    path = tmp_path / "a.cogs"
    path.write_bytes(b"mine")
    with pytest.raises(StorageError) as caught:
        cogs.save(encoded("near-lossless"), path, writer="x")
    assert (caught.value.code, path.read_bytes()) == ("exists", b"mine")


@pytest.mark.parametrize("profile", PROFILES)
def test_order_of_segments_serves_a_prefix(profile):
    made = encoded(profile)
    kinds = [(s.kind, s.owner) for s in cogs.segments(made)]
    assert [owner for kind, owner in kinds if kind == SegmentKind.HEAD] == list(range(6))
    first_head = kinds.index((SegmentKind.HEAD, 0))
    for number, book in enumerate(made.codebooks):
        if book.attribute == "shape":
            assert kinds.index((SegmentKind.SHAPE_CODEBOOK, number)) < first_head
        else:
            places = [kinds.index((band, number)) for band in COLOUR_BANDS]
            assert places == sorted(places)
            assert first_head < places[0]
    for chunk in range(6):
        tail = kinds.index((SegmentKind.TAIL, chunk))
        assert kinds.index((SegmentKind.HEAD, chunk)) < tail
        for kind, owner in kinds[tail:]:
            assert kind != SegmentKind.COLOUR_BAND3, owner
    for chunk, part in enumerate(made.chunks):
        refined = (SegmentKind.REFINEMENT, chunk)
        assert (refined in kinds) == (part.payloads.refinement is not None)
        if refined in kinds:
            assert kinds.index((SegmentKind.HEAD, chunk)) < kinds.index(refined)


@pytest.mark.parametrize("profile", PROFILES)
def test_every_prefix_with_a_head_draws(profile):
    data = file_of(profile)
    counts = []
    for share in range(0, 101, 5):
        with open_cogs(
            BytesSource(data[: max(len(data) * share // 100, 3000)]), partial=True
        ) as part:
            counts.append(len(part.decode()))
    assert counts == sorted(counts)
    assert counts[-1] == 900
    assert counts[10] > 300


def test_boxes_hold_their_decoded_splats_as_float32():
    splats = scene(700, 0)
    splats.means[:] *= np.float32(1e5)
    made = encode(splats, None, unseen(profile="near-lossless", chunk_splats=100, prune=None))
    root = cogs.build_root(made, "x")
    with open_cogs(BytesSource(b"".join(lay_out(root, cogs.segments(made))))) as file:
        reach = np.array([box(part) for part in file.iter_chunks()])
    low, high = (root.chunks.box[:, cut].astype(np.float64) for cut in (slice(3), slice(3, 6)))
    assert (low <= reach[:, :3]).all()
    assert (high >= reach[:, 3:]).all()
    # And no further out than float32 must.
    inward = np.nextafter(root.chunks.box[:, :3], np.float32(np.inf)).astype(np.float64)
    assert (inward > reach[:, :3]).all()
    assert np.array_equal(root.box, [*reach[:, :3].min(axis=0), *reach[:, 3:].max(axis=0)])


def test_the_first_look_goes_along_and_the_core_box_is_cut_to_the_scene(tmp_path):
    view = Camera(
        320, 200, 300.0, 310.0, 160.0, 100.0, np.eye(3), np.array([0.5, 0.0, 4.0]), "name"
    )
    look = FirstLook(np.array([0.0, 0.0, 1.0]), view, np.array([-1e9] * 3 + [1e9] * 3))
    cogs.save(encoded("near-lossless"), tmp_path / "a.cogs", writer="x", look=look)
    with open_cogs(FileSource(tmp_path / "a.cogs")) as file:
        found = file.root.first_view
        assert found is not None
        assert (found.width, found.height, found.fx, found.fy) == (320, 200, 300.0, 310.0)
        assert np.array_equal(found.translation, view.translation)
        assert file.root.up is not None
        assert file.root.up.tolist() == [0.0, 0.0, 1.0]
        assert np.array_equal(file.root.core_box, file.root.box)


def test_an_empty_scene_is_a_file():
    made = encode(scene(3).take(slice(0, 0)), None, unseen(profile="near-lossless"))
    data = b"".join(lay_out(cogs.build_root(made, "x"), cogs.segments(made)))
    with open_cogs(BytesSource(data)) as file:
        file.verify()
        assert (file.num_chunks, len(file.decode()), file.decode().sh_degree) == (0, 0, 3)
