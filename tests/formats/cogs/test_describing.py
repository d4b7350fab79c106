"""Descriptions that change in a file or folder, while all else keeps its bytes."""

import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from fault_server import FaultServer, serving
from pictures import picture

import cogsplat
from cogsplat import Description, Picture
from cogsplat.codec.errors import CogsplatError, CogsplatWarning, DataError
from cogsplat.codec.segments.attributes import AttributeType, pack_attributes
from cogsplat.formats.cogs import canonical_msgpack
from cogsplat.formats.cogs.description_segment import unpack_description
from cogsplat.formats.cogs.index_tables import ChunkTable
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.root import camera_map
from cogsplat.formats.cogs.writer import Segment, write_cogs

VECTORS = Path(__file__).resolve().parents[2] / "vectors" / "valid"

NAMES = ["one-splat", "empty", "pages", "pages-only", "levels", "attributes-pages", "pictures"]


def described():
    return Description(
        title="Garden",
        poster=Picture("image/jpeg", 6, 3, data=picture()),
        sky=Picture("image/webp", 6, 3, data=picture("WEBP")),
    )


def other_hashes(file):
    kinds = (SegmentKind.DESCRIPTION, SegmentKind.PICTURE)
    rows = zip(file.segments.kind, file.segments.hash, strict=True)
    return [digest.tobytes() for kind, digest in rows if kind not in kinds]


@pytest.mark.parametrize("name", NAMES)
def test_a_described_file_keeps_all_other_segments(name, tmp_path):
    source, out = VECTORS / f"{name}.cogs", tmp_path / "new.cogs"
    done = cogsplat.describe(source, described(), out, up="+y", view="0,0,-4,0,0,0,45")
    assert done.size_bytes == done.written_bytes == out.stat().st_size
    with cogsplat.open(source) as before, cogsplat.open(out) as after:
        after.verify()
        found = after.description(pictures=True)
        assert (found.title, found.poster.data, found.sky.data) == (
            "Garden", picture(), picture("WEBP"),
        )  # fmt: skip
        assert other_hashes(after) == other_hashes(before)
        assert after.root.up.tolist() == [0.0, 1.0, 0.0]
        assert after.root.first_view.position == pytest.approx([0.0, 0.0, -4.0])
        assert after.root.levels == before.root.levels
        assert np.array_equal(after.chunks.box, before.chunks.box)


def test_a_removed_description_leaves_the_file_that_was(tmp_path):
    cogsplat.describe(VECTORS / "sh2.cogs", None, tmp_path / "plain.cogs")
    cogsplat.describe(VECTORS / "sh2.cogs", described(), tmp_path / "new.cogs")
    cogsplat.describe(tmp_path / "new.cogs", Description(), force=True)
    assert (tmp_path / "new.cogs").read_bytes() == (tmp_path / "plain.cogs").read_bytes()


def test_keys_of_later_versions_stay(tmp_path):
    with cogsplat.open(VECTORS / "one-splat.cogs") as file:
        segments = [Segment(SegmentKind.HEAD, 0, bytes(file.read_segment(0)))]
        root = replace(file.root, unknown={"weather": {"rain": True}})
        view = {"name": "Door", **camera_map(file.first_view(view="0,0,-4,0,0,0,45"))}
    stored = {"title": "Old", "mood": 7, "views": [view]}
    segments.append(Segment(SegmentKind.DESCRIPTION, 0, canonical_msgpack.pack(stored)))
    write_cogs(root, segments, tmp_path / "scene.cogs")
    before = replace(unpack_description(segments[1].payload, "x"), title="New")
    cogsplat.describe(tmp_path / "scene.cogs", before, up="+y", force=True)
    with cogsplat.open(tmp_path / "scene.cogs") as file:
        assert file.root.unknown == {"weather": {"rain": True}}
        payload = bytes(file.read_segment(file.description_row))
    assert canonical_msgpack.unpack(payload, "x") == stored | {"title": "New"}


def test_keys_of_later_versions_inside_maps_are_named(tmp_path):
    with cogsplat.open(VECTORS / "one-splat.cogs") as file:
        segments = [Segment(SegmentKind.HEAD, 0, bytes(file.read_segment(0)))]
        view = {"name": "Door", **camera_map(file.first_view(view="0,0,-4,0,0,0,45")), "lens": 2}
        payload = canonical_msgpack.pack({"views": [view]})
        segments.append(Segment(SegmentKind.DESCRIPTION, 0, payload))
        write_cogs(file.root, segments, tmp_path / "scene.cogs")
    new = replace(unpack_description(payload, "x"), title="New")
    with pytest.warns(CogsplatWarning, match=r"left out: description.views\[0\].lens$"):
        cogsplat.describe(tmp_path / "scene.cogs", new, force=True)


def objects_of(folder):
    return {path.name: path.stat().st_mtime_ns for path in (folder / "segments").iterdir()}


def test_a_title_in_a_folder_is_a_new_manifest_alone(tmp_path):
    folder = tmp_path / "scene"
    cogsplat.unpack(VECTORS / "pictures-pages.cogs", folder)
    before = objects_of(folder)
    with cogsplat.open(folder) as file:
        old = file.description()
    done = cogsplat.describe(folder, Description(title="New", poster=old.poster, sky=old.sky),
                             force=True)  # fmt: skip
    assert objects_of(folder) == before
    assert done.written_bytes == (folder / "manifest.cogsm").stat().st_size
    with cogsplat.open(folder) as file:
        file.verify()
        assert file.description(pictures=True).title == "New"


def test_a_first_title_and_another_up_change_no_page(tmp_path):
    folder = tmp_path / "scene"
    # Enough chunks for pages; their heads are equal, their objects are not.
    with cogsplat.open(VECTORS / "one-splat.cogs") as file:
        head, rows = bytes(file.read_segment(0)), np.zeros(600, np.int64)
        table = {each.name: getattr(file.chunks, each.name)[rows] for each in fields(ChunkTable)}
        root = replace(file.root, splats=600, chunks=ChunkTable(**table), up=np.array([0, 1.0, 0]),
                       attributes=[AttributeType("n", "u4")])  # fmt: skip
    segments = []
    for n in range(600):
        label = pack_attributes({"n": np.array([n], np.uint32)})
        segments += [Segment(SegmentKind.HEAD, n, head), Segment(SegmentKind.ATTRIBUTES, n, label)]
    write_cogs(root, segments, tmp_path / "scene.cogs")
    cogsplat.unpack(tmp_path / "scene.cogs", folder)
    before = objects_of(folder)
    assert len(before) > 600
    cogsplat.describe(folder, Description(title="First"), force=True)
    cogsplat.describe(folder, Description(title="Second"), up="-y", force=True)
    assert objects_of(folder) == before


def test_a_long_description_is_an_object(tmp_path):
    folder = tmp_path / "scene"
    cogsplat.unpack(VECTORS / "one-splat.cogs", folder)
    before = objects_of(folder)
    done = cogsplat.describe(folder, Description(text="x" * 16_384), force=True)
    (new,) = objects_of(folder).keys() - before.keys()
    size = (folder / "segments" / new).stat().st_size
    assert done.written_bytes == size + (folder / "manifest.cogsm").stat().st_size
    assert (folder / "manifest.cogsm").stat().st_size < 1000


def test_a_folder_gets_a_second_manifest(tmp_path):
    folder = tmp_path / "scene"
    cogsplat.unpack(VECTORS / "sh1.cogs", folder)
    cogsplat.describe(folder, Description(title="French"), folder / "fr.cogsm")
    with cogsplat.open(folder) as plain, cogsplat.open(folder / "fr.cogsm") as french:
        assert plain.description() is None
        assert french.description().title == "French"


def test_nothing_is_replaced_unless_told(tmp_path):
    scene = tmp_path / "scene.cogs"
    shutil.copy(VECTORS / "sh1.cogs", scene)
    folder = tmp_path / "scene"
    cogsplat.unpack(scene, folder)
    calls = {
        "exists": [(scene, None), (folder, None), (scene, folder / "manifest.cogsm")],
        "output-is-input": [(scene, scene), (folder, folder)],
    }
    before = scene.read_bytes()
    for code, cases in calls.items():
        for given, out in cases:
            with pytest.raises(CogsplatError) as caught:
                cogsplat.describe(given, described(), out, force=code == "output-is-input")
            assert caught.value.code == code
    assert scene.read_bytes() == before
    cogsplat.describe(scene, described(), force=True)
    with cogsplat.open(scene) as file:
        assert file.description().title == "Garden"


def test_a_picture_without_its_file_is_that_of_the_scene(tmp_path):
    first, second = tmp_path / "first.cogs", tmp_path / "second.cogs"
    cogsplat.describe(VECTORS / "sh1.cogs", described(), first)
    with cogsplat.open(first) as file:
        known = file.description()
    cogsplat.describe(first, Description(poster=known.poster), second)
    with cogsplat.open(second) as file:
        assert file.description(pictures=True).poster.data == picture()
    with pytest.raises(DataError, match="poster: no file"):
        cogsplat.describe(VECTORS / "sh1.cogs", Description(poster=known.poster), second,
                          force=True)  # fmt: skip


def test_a_damaged_segment_is_not_copied(tmp_path):
    data = bytearray((VECTORS / "sh1.cogs").read_bytes())
    data[-1] ^= 1
    (tmp_path / "bad.cogs").write_bytes(data)
    with pytest.raises(CogsplatError) as caught:
        cogsplat.describe(tmp_path / "bad.cogs", described(), tmp_path / "new.cogs")
    assert caught.value.code == "segment-crc"
    assert not (tmp_path / "new.cogs").exists()


def test_an_encode_keeps_the_description_of_its_source(tmp_path):
    scene = tmp_path / "scene.cogs"
    from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

    cogsplat.encode(synth(300), scene, cameras=synth_cameras(3), description=described())
    cogsplat.encode(scene, tmp_path / "again.cogs", cameras=synth_cameras(3), preset="fast")
    with cogsplat.open(tmp_path / "again.cogs") as file:
        file.verify()
        assert file.description(pictures=True).sky.data == picture("WEBP")


def test_over_a_network_a_description_takes_one_request(tmp_path):
    data = (VECTORS / "pictures-pages.cogs").read_bytes()
    with serving(FaultServer(data)) as server, cogsplat.open(server.url()) as file:
        assert file.description().poster.width == 4
        assert len(file.description(pictures=True).pictures()) == 2


def test_a_file_without_its_last_page_is_checked_as_far_as_it_goes():
    data = (VECTORS / "pictures-pages.cogs").read_bytes()
    with cogsplat.open(data) as whole:
        end = int(whole.offsets[len(whole.root.segments) - 1])
        end += int(whole.root.segments.length[-1])
    with cogsplat.open(data, size_bytes=end) as file:
        assert not file.has_all_pages
        file.verify()
        with pytest.raises(CogsplatError) as caught:
            file.description(pictures=True)
    assert caught.value.code == "file-truncated"


def test_a_cut_file_gives_what_has_come():
    data = (VECTORS / "pictures.cogs").read_bytes()
    with cogsplat.open(data, size_bytes=len(data) - 1) as file:
        assert file.description().sky.width == 4
        with pytest.raises(CogsplatError) as caught:
            file.description(pictures=True)
    assert caught.value.code == "file-truncated"
