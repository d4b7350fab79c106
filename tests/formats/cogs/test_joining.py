"""Files of parts as one file: the same splats, one index, each part's tables where it is alone."""

from contextlib import ExitStack, contextmanager
from dataclasses import replace

import numpy as np
import pytest

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.errors import DataError, StorageError
from cogsplat.codec.scoring.contribution import zero_scores
from cogsplat.codec.scoring.panorama_shares import panorama_shares
from cogsplat.formats.cogs import joined_view_tables
from cogsplat.formats.cogs.segment_rows import CHUNK_KINDS
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CAMERAS = synth_cameras(8)
SPLATS = 26_000
CONFIG = EncodeConfig(cells=True, chunk_splats=256, prune=None)


def part(scene, side, parts=3):
    """Return the splats of one of the slabs along x."""
    edges = np.quantile(scene.means[:, 0], np.linspace(0, 1, parts + 1)[1:-1])
    return scene.take(np.searchsorted(edges, scene.means[:, 0]) == side)


def encoded(splats, path, *, like=None, config=CONFIG, **options):
    basis = None
    if like is not None:
        with cogsplat.open(like) as file:
            basis = file.stored_codebook(0)
    request = EncodeRequest(cameras=CAMERAS, preset="fast", basis=basis, config=config, **options)
    cogsplat.encode(splats, path, request=request)
    return path


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    scene = synth(SPLATS, sh_degree=2)
    first = encoded(part(scene, 0), folder / "0.cogs")
    others = [encoded(part(scene, n), folder / f"{n}.cogs", like=first) for n in (1, 2)]
    return [first, *others]


@pytest.fixture(scope="module")
def joined(parts, tmp_path_factory):
    out = tmp_path_factory.mktemp("joined") / "all.cogs"
    made = cogsplat.join(parts, out)
    assert (made.path, made.size_bytes, made.parts) == (out, out.stat().st_size, 3)
    return out


@contextmanager
def opened(paths):
    with ExitStack() as stack:
        yield [stack.enter_context(cogsplat.open(path)) for path in paths]


def payloads(file):
    """Return the bytes of the segments of chunks and codebooks, sorted."""
    kinds = [*CHUNK_KINDS, *range(3, 7)]
    rows = np.flatnonzero(np.isin(file.segments.kind, kinds))
    return sorted({bytes(file.read_segment(row)) for row in rows})


def numbers_of(parts, joined):
    """Return the numbers that the chunks of each part have in the joined file."""
    with cogsplat.open(joined) as whole:
        heads = {
            bytes(whole.read_segment(whole.chunk_rows(chunk).head)): chunk
            for chunk in range(whole.num_chunks)
        }
    found = []
    for path in parts:
        with cogsplat.open(path) as file:
            own = [file.chunk_rows(chunk).head for chunk in range(file.num_chunks)]
            found.append([heads[bytes(file.read_segment(row))] for row in own])
    return found


def test_the_joined_file_is_whole_and_keeps_every_byte_of_its_parts(parts, joined):
    with opened(parts) as files, cogsplat.open(joined) as whole:
        whole.verify()
        assert len(whole.indices) > 1
        assert whole.root.splats == sum(file.root.splats for file in files)
        assert payloads(whole) == sorted({each for file in files for each in payloads(file)})
        for file, numbers in zip(files, numbers_of(parts, joined), strict=True):
            found, expected = whole.decode(sorted(numbers)), file.decode()
            rows = np.argsort(numbers)
            starts = np.concatenate([[0], np.cumsum(file.chunks.splats)]).astype(int)
            order = np.concatenate([np.arange(starts[n], starts[n + 1]) for n in rows])
            for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[order])
            assert (whole.chunks.box[numbers] == file.chunks.box).all()


def test_no_chunk_has_a_parent_in_another_part(parts, joined):
    with cogsplat.open(joined) as whole:
        own = whole.parents()
    for numbers in map(set, numbers_of(parts, joined)):
        # But for the first of each part, every chunk has one.
        assert [own[chunk] in numbers for chunk in sorted(numbers)] == [False] + [True] * (
            len(numbers) - 1
        )


def test_first_layers_shift_the_chunks_of_each_part_as_before(parts, joined):
    numbers = numbers_of(parts, joined)
    with opened(parts) as files, cogsplat.open(joined) as whole:
        compensation = whole.compensation()
        assert len(compensation.layers) > 1
        for layer, own in enumerate(compensation.layers):
            counts = [file.compensation().layers[layer].chunks for file in files]
            assert own.chunks == sum(counts)
            for file, of_part, count in zip(files, numbers, counts, strict=True):
                chunks = np.arange(count)
                alone = file.compensation()
                expected = alone.shifts_of(chunks, np.full(count, count))
                held = np.array(of_part)[chunks]
                found = compensation.shifts_of(held, np.full(count, own.chunks))
                np.testing.assert_array_equal(found, expected)


def viewpoints(table):
    return {position.tobytes() for position in table.positions}


def test_an_index_has_viewpoints_of_its_part_and_one_with_several_parts_of_all(parts, joined):
    numbers = numbers_of(parts, joined)
    with opened(parts) as files:
        own = [viewpoints(file.view_table()) for file in files]
    single = 0
    with cogsplat.open(joined) as whole:
        for node in whole.indices:
            last = node.first_chunk + node.tables.extent.chunks
            below = set(range(node.first_chunk, last))
            inside = [number for number, chunks in enumerate(numbers) if below <= set(chunks)]
            found = viewpoints(whole.view_table(node.path))
            if inside:
                single += 1
                assert found <= own[inside[0]]
            else:
                assert found <= set().union(*own)
                if not node.path:
                    assert all(found & of_part for of_part in own)
    assert single


def test_the_root_knows_what_parts_hide_of_each_other(parts, joined):
    numbers = numbers_of(parts, joined)
    part_of = np.empty(sum(map(len, numbers)), np.int64)
    for part_number, chunks in enumerate(numbers):
        part_of[chunks] = part_number
    with cogsplat.open(joined) as whole:
        table, root = whole.view_table(), whole.indices[0]
        splats = whole.decode(extras=False)
        owners = np.repeat(part_of, whole.chunks.splats)
        pages = [node.first_chunk for node in whole.indices if len(node.path) == 1]
        columns = part_of[[*range(len(root.tables.chunks)), *pages]]
    true = panorama_shares(splats, owners, len(parts), table.positions)
    found = np.stack(
        [table.shares[:, columns == part].sum(axis=1) for part in range(len(parts))], axis=1
    )
    # Only the first chunks are drawn, and codes are coarse.
    assert (np.abs(found - true) < 0.02 + 0.1 * true).all()
    assert true.std(axis=0).min() > 0.06, "what the viewpoints see differs"


def test_a_joined_file_is_joined_again(parts, tmp_path, monkeypatch):
    # In a large scene, the root of a joined file has not all viewpoints of its pages.
    with monkeypatch.context() as patch:
        patch.setattr(joined_view_tables, "MAX_VIEWS", 3)
        cogsplat.join(parts, tmp_path / "three.cogs")
    made = cogsplat.join([tmp_path / "three.cogs", parts[2]], tmp_path / "four.cogs")
    with (
        cogsplat.open(tmp_path / "three.cogs") as three,
        cogsplat.open(parts[2]) as last,
        cogsplat.open(made.path) as four,
    ):
        root = viewpoints(three.view_table())
        pages = [viewpoints(three.view_table(page.path)) for page in three.indices[1:]]
        assert any(not found <= root for found in pages)
        four.verify()
        assert four.root.splats == three.root.splats + last.root.splats
        assert viewpoints(four.view_table()) <= viewpoints(last.view_table())


def test_the_same_part_twice_has_each_viewpoint_once(parts, tmp_path):
    cogsplat.join([parts[0], parts[0]], tmp_path / "twice.cogs")
    with cogsplat.open(parts[0]) as file, cogsplat.open(tmp_path / "twice.cogs") as twice:
        table = twice.view_table()
        assert len(viewpoints(table)) == len(table.positions)
        assert viewpoints(table) <= viewpoints(file.view_table())


def test_a_part_is_replaced_without_the_others(parts, joined, tmp_path):
    again = encoded(part(synth(3000, sh_degree=2, seed=5), 1), tmp_path / "1.cogs", like=parts[0])
    cogsplat.join([parts[0], again, parts[2]], tmp_path / "new.cogs")
    with cogsplat.open(tmp_path / "new.cogs") as new:
        new.verify()
        for path in (parts[0], again, parts[2]):
            with cogsplat.open(path) as file:
                assert set(payloads(file)) < set(payloads(new))
    cogsplat.join(parts, tmp_path / "same.cogs")
    assert (tmp_path / "same.cogs").read_bytes() == joined.read_bytes()


def test_many_parts_are_joined(tmp_path):
    scene = synth(1000, sh_degree=0)
    config = EncodeConfig(order="source", prune=None, cells=True)
    paths = []
    for number in range(150):
        path = tmp_path / f"{number}.cogs"
        splats = part(scene, number, 150)
        scores = zero_scores(len(splats))
        cogsplat.encode(splats, path, request=EncodeRequest(config=config, scores=scores))
        paths.append(path)
    cogsplat.join(paths, tmp_path / "all.cogs")
    with cogsplat.open(tmp_path / "all.cogs") as whole:
        whole.verify()
        assert whole.root.splats == len(scene)
        assert (len(whole.root.chunks), whole.num_chunks) == (64, 150)
        assert whole.parents().tolist() == [-1] * whole.num_chunks


def test_parts_that_have_pages_are_joined(tmp_path):
    scene = synth(30_000, sh_degree=1)
    config = EncodeConfig(order="contribution", prune=None, cells=True, chunk_splats=64)
    paths = []
    for number in range(2):
        splats, basis = part(scene, number, 2), None
        if paths:
            with cogsplat.open(paths[0]) as file:
                basis = file.stored_codebook(0)
        # Scores that rise along y, so that chunks of one page lie in several of the joined file.
        scores = zero_scores(len(splats))
        scores.contribution[:] = splats.means[:, 1] - splats.means[:, 1].min()
        request = EncodeRequest(config=config, scores=scores, basis=basis)
        paths.append(tmp_path / f"{number}.cogs")
        cogsplat.encode(splats, paths[-1], request=request)
    cogsplat.join(paths, tmp_path / "all.cogs")
    with opened(paths) as files, cogsplat.open(tmp_path / "all.cogs") as whole:
        assert min(len(file.indices) for file in files) > 2
        whole.verify()
        assert payloads(whole) == sorted({each for file in files for each in payloads(file)})
        for node in whole.indices[1:]:
            last = node.first_chunk + node.tables.extent.chunks
            below = whole.chunks.cell[node.first_chunk : last].tolist()
            assert len({f"{cell:b}"[:2] for cell in below}) == 1


def test_parts_of_one_chunk_and_an_uncut_file_are_joined(tmp_path):
    scene = synth(2000, sh_degree=0)
    one = encoded(part(scene, 0), tmp_path / "a.cogs", config=EncodeConfig(chunk_splats=256))
    two = encoded(part(scene, 1), tmp_path / "b.cogs", config=replace(CONFIG, chunk_splats=4096))
    cogsplat.join([one, two], tmp_path / "all.cogs")
    with cogsplat.open(tmp_path / "all.cogs") as whole:
        whole.verify()
        assert set(whole.chunks.cell.tolist()) == {2, 3}


def test_the_first_part_tells_how_the_whole_is_shown(parts, tmp_path):
    told = tmp_path / "told.cogs"
    cogsplat.describe(
        parts[0], cogsplat.Description(title="City"), told, up="+y", view="0,0,-4,0,0,0,45"
    )
    cogsplat.join([told, parts[1]], tmp_path / "all.cogs")
    with cogsplat.open(tmp_path / "all.cogs") as whole:
        assert whole.description().title == "City"
        assert whole.root.up.tolist() == [0.0, 1.0, 0.0]
        assert whole.root.first_view.position == pytest.approx([0.0, 0.0, -4.0])


def test_stored_cameras_are_kept_once(tmp_path):
    scene = synth(1000, sh_degree=0)
    paths = [
        encoded(part(scene, n), tmp_path / f"{n}.cogs", stored_cameras=CAMERAS[: 3 + n])
        for n in range(2)
    ]
    cogsplat.join(paths, tmp_path / "all.cogs")
    with cogsplat.open(tmp_path / "all.cogs") as whole:
        assert len(whole.cameras()) == 4


def refused(paths, out):
    with pytest.raises(DataError) as caught:
        cogsplat.join(paths, out)
    assert caught.value.code == "cannot-join"
    assert not out.exists()
    return caught.value.message


def test_files_that_do_not_belong_together_are_refused(parts, tmp_path):
    scene = synth(1500, sh_degree=2)
    alone = encoded(part(scene, 0), tmp_path / "alone.cogs")
    assert "--basis-of 0.cogs" in refused([parts[0], alone], tmp_path / "x.cogs").replace(
        f"{parts[0].parent}/", ""
    )
    flat = encoded(synth(300, sh_degree=0), tmp_path / "flat.cogs")
    assert "SH degree 0, expected 2" in refused([parts[0], flat], tmp_path / "x.cogs")
    moved = replace(scene, info=replace(scene.info, origin=(1.0, 0.0, 0.0)))
    moved = encoded(moved, tmp_path / "moved.cogs", like=parts[0])
    assert "origin" in refused([parts[0], moved], tmp_path / "x.cogs")
    named = replace(scene, extras={"row": np.arange(len(scene), dtype="i4")})
    named = encoded(named, tmp_path / "named.cogs", like=parts[0])
    assert "attributes" in refused([parts[0], named], tmp_path / "x.cogs")


def test_an_output_is_not_replaced_unasked_and_an_input_never(parts, tmp_path):
    out = tmp_path / "all.cogs"
    cogsplat.join(parts, out)
    with pytest.raises(StorageError, match="exists"):
        cogsplat.join(parts, out)
    before = parts[0].read_bytes()
    with pytest.raises(StorageError):
        cogsplat.join(parts, parts[0], force=True)
    assert parts[0].read_bytes() == before
    with pytest.raises(ValueError, match="no files"):
        cogsplat.join([], out)


def test_a_given_basis_is_stored_as_it_is_and_must_fit(parts, tmp_path):
    with cogsplat.open(parts[0]) as one, cogsplat.open(parts[1]) as other:
        assert one.stored_codebook(0).payloads == other.stored_codebook(0).payloads
        basis = one.stored_codebook(0)
    with pytest.raises(DataError) as caught:
        encoded(synth(300, sh_degree=1), tmp_path / "x.cogs", like=parts[0])
    assert caught.value.code == "basis-mismatch"
    with pytest.raises(ValueError, match="'vq'"):
        EncodeRequest(basis=basis, config=EncodeConfig(profile="vq"))
    with pytest.raises(ValueError, match="shape"):
        EncodeRequest(basis=replace(basis, attribute="shape"))


def test_segments_come_in_the_order_of_the_parts(parts, joined):
    """Between two heads of a part stand the same segments of it, in the same order."""

    def order(file):
        rows = np.flatnonzero(np.isin(file.root.segments.kind, CHUNK_KINDS))
        return [bytes(file.read_segment(row)) for row in rows]

    with cogsplat.open(joined) as whole:
        found = order(whole)
    taken = 0
    for path in parts:
        with cogsplat.open(path) as file:
            own = order(file)
        inside = [each for each in own if each in set(found)]
        assert [each for each in found if each in set(own)] == inside
        taken += len(inside)
    assert taken == len(found)
