import hashlib
import io
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import capture_of_cameras
from cogsplat.codec.encode.config import PROFILE_NAMES, EncodeConfig
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.errors import Cancelled, DataError, FormatError, StorageError, TruncatedError
from cogsplat.codec.geometry import rotations
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import Splats, empty
from cogsplat.codec.streams.grid import MAX_VALUE
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.storage.source import FileSource

ROOT = Path(__file__).resolve().parents[1]
FIELDS = ("means", "scales", "quats", "opacities", "sh0", "shN")
KEEP = EncodeConfig(prune=None, chunk_splats=50, threads=1)
# The default order draws the scene, which takes cameras.
SCORED = replace(KEEP, order="contribution")


def scene(n=300, degree=3, seed=1) -> Splats:
    rng = np.random.default_rng(seed)
    blank = empty(degree, n)
    return replace(
        blank,
        means=rng.normal(size=(n, 3)).astype(np.float32),
        scales=rng.normal(-2.5, 0.5, (n, 3)).astype(np.float32),
        quats=rng.normal(size=(n, 4)).astype(np.float32),
        opacities=rng.normal(1, 1, n).astype(np.float32),
        sh0=rng.normal(size=(n, 3)).astype(np.float32),
        shN=(0.2 * rng.normal(size=blank.shN.shape)).astype(np.float32),
    )


def scored(scores):
    """Return a request of scores that are there already."""
    return EncodeRequest(scores=scores, config=SCORED)


def ring(count=4, distance=5.0) -> list[Camera]:
    cameras = []
    for angle in np.linspace(0, 2 * math.pi, count, endpoint=False):
        cos, sin = math.cos(angle), math.sin(angle)
        rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
        shift = np.array([0.0, 0.0, distance])
        cameras.append(Camera(48, 40, 45.0, 45.0, 24.0, 20.0, rotation, shift, f"view {angle}"))
    return cameras


def same(a, b):
    return all(getattr(a, f).tobytes() == getattr(b, f).tobytes() for f in FIELDS)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A file of several chunks, its scene and its scores."""
    path = tmp_path_factory.mktemp("facade") / "scene.cogs"
    splats = scene()
    scores = score(splats, ring(), ScoreConfig(threads=1))
    report = cogsplat.encode(splats, path, request=scored(scores))
    assert report.size_bytes == path.stat().st_size
    return path, splats, scores


# Encoding.


@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize(("n", "degree"), [(0, 3), (1, 0), (2, 1), (100, 2), (100, 3)])
def test_scenes_of_any_size_come_back(tmp_path, profile, n, degree):
    splats = scene(n, degree)
    path = tmp_path / "out.cogs"
    config = replace(KEEP, profile=profile, quality_db=60.0, morton=False, order="source")
    cogsplat.encode(splats, path, cameras=ring(), config=config)
    out = cogsplat.decode(path)
    assert (len(out), out.sh_degree) == (n, degree)
    np.testing.assert_allclose(out.sh0, splats.sh0, atol=0.1)
    np.testing.assert_allclose(out.means, splats.means, atol=0.1)
    assert out.info == replace(splats.info, capture=capture_of_cameras(ring()))
    assert [file.name for file in tmp_path.iterdir()] == ["out.cogs"]


def test_without_cameras_virtual_views_are_scored(tmp_path):
    splats = scene(200)
    stages = []
    path = tmp_path / "virtual.cogs"
    cogsplat.encode(splats, path, progress=lambda *call: stages.append(call))
    looks = 6 * PRESETS["balanced"].planned_views
    assert ("plan views", looks, looks) in stages
    assert any(stage == "score" and total >= 3 * 64 for stage, _, total in stages)
    assert len(cogsplat.decode(path)) <= 200
    with cogsplat.open(path) as file:
        assert file.root.up is not None


def test_the_share_of_the_whole_rises_to_one(tmp_path):
    shares, stages = [], []
    cogsplat.encode(
        scene(200),
        tmp_path / "out.cogs",
        cameras=ring(),
        progress=cogsplat.OverallProgress(
            progress=lambda *call: stages.append(call), overall=shares.append
        ),
    )
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < 0.5
    assert shares[-1] == 1.0
    assert len(shares) == len(stages) + 1


def test_raising_from_the_share_leaves_no_file(tmp_path):
    def stop(share):
        raise Cancelled("enough")

    progress = cogsplat.OverallProgress(overall=stop)
    with pytest.raises(Cancelled):
        cogsplat.encode(scene(200), tmp_path / "out.cogs", cameras=ring(), progress=progress)
    assert list(tmp_path.iterdir()) == []


def test_given_scores_are_not_measured_again(tmp_path, made):
    path, splats, scores = made
    stages = set()
    again = tmp_path / "again.cogs"
    cogsplat.encode(
        splats, again, request=scored(scores), progress=lambda *call: stages.add(call[0])
    )
    assert "score" not in stages
    assert again.read_bytes() == path.read_bytes()


def test_cameras_and_scenes_may_be_files(tmp_path):
    splats, cameras = scene(120), ring()
    cogsplat.write(splats, tmp_path / "scene.ply")
    write_cameras_json(cameras, tmp_path / "cameras.json")
    a, b = tmp_path / "a.cogs", tmp_path / "b.cogs"
    config = replace(KEEP, profile="near-lossless")
    cogsplat.encode(str(tmp_path / "scene.ply"), str(a), cameras=str(tmp_path / "cameras.json"),
                    config=config)  # fmt: skip
    read = cogsplat.read_cameras(tmp_path / "cameras.json")
    assert len(read) == len(cameras)
    cogsplat.encode(cogsplat.read(tmp_path / "scene.ply"), b, cameras=read, config=config)
    assert a.read_bytes() == b.read_bytes()
    with cogsplat.open(a) as file:
        view, up = file.root.first_view, file.root.up
        assert view is not None
        assert up is not None
        assert view.target is not None
        np.testing.assert_allclose(view.rotation[0] @ up, 0.0, atol=1e-9)
        assert any(np.allclose(view.position, camera.position) for camera in cameras)
    cogsplat.encode(a, tmp_path / "c.cogs", cameras=cameras, config=config)
    assert len(cogsplat.read(tmp_path / "c.cogs")) == 120


def test_an_existing_file_is_refused_before_any_work(tmp_path, made):
    path, splats, scores = made
    target = tmp_path / "there.cogs"
    target.write_bytes(b"mine")
    stages = []
    with pytest.raises(StorageError) as caught:
        cogsplat.encode(splats, target, cameras=ring(), progress=lambda *call: stages.append(call))
    assert (caught.value.code, caught.value.exit_code) == ("exists", 2)
    assert stages == []
    assert target.read_bytes() == b"mine"
    cogsplat.encode(splats, target, request=scored(scores), force=True)
    assert target.read_bytes() == path.read_bytes()
    with pytest.raises(StorageError) as caught:
        cogsplat.encode(splats, tmp_path / "no" / "such.cogs", request=scored(scores))
    assert caught.value.code == "not-found"


@pytest.mark.parametrize("force", [False, True])
def test_cancelling_anywhere_leaves_no_file_and_keeps_the_old_one(tmp_path, force):
    splats, cameras = scene(120), ring(2)
    target = tmp_path / "out.cogs"
    calls = []
    cogsplat.encode(
        splats, target, cameras=cameras, config=KEEP, progress=lambda *call: calls.append(call)
    )
    target.write_bytes(b"old") if force else target.unlink()
    stages = {"score", "order", "gain", "quantisers", "chunks", "reference views", "compensate"}
    stages |= {"predict"}
    assert {call[0] for call in calls} == stages

    def stop(stage, done, total):
        reached.append((stage, done, total))
        if len(reached) > allowed:
            raise Cancelled

    for allowed in range(len(calls)):
        reached = []
        with pytest.raises(Cancelled) as caught:
            cogsplat.encode(
                splats, target, cameras=cameras, config=KEEP, progress=stop, force=force
            )
        assert caught.value.exit_code == 130
        assert reached == calls[: allowed + 1]
        assert [file.name for file in tmp_path.iterdir()] == (["out.cogs"] if force else [])
    if force:
        assert target.read_bytes() == b"old"


@pytest.mark.parametrize(
    ("broken", "code"),
    [
        ({"means": np.full((300, 3), np.nan, np.float32)}, "invalid-rows"),
        ({"quats": np.zeros((300, 4), np.float32)}, "invalid-rows"),
        ({"opacities": np.full(300, -np.inf, np.float32)}, "cameras-see-nothing"),
        ({"sh0": np.full((300, 3), 1e35, np.float32)}, "value-range"),
    ],
)
def test_scenes_that_cannot_be_used_are_refused(tmp_path, broken, code):
    with pytest.raises(DataError) as caught:
        cogsplat.encode(replace(scene(), **broken), tmp_path / "out.cogs", cameras=ring())
    assert caught.value.code == code
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize("factor", [2.0**100, 2.0**-100, 2.0**-130])
def test_quaternions_of_any_size_are_normalised(tmp_path, factor, profile):
    config = replace(KEEP, profile=profile)
    splats = scene(60, 1)
    written = []
    for name, quats in (("unit", rotations.unit(splats.quats)), ("extreme", splats.quats * factor)):
        path = tmp_path / f"{name}.cogs"
        quats = quats.astype(np.float32)
        cogsplat.encode(replace(splats, quats=quats), path, cameras=ring(), config=config)
        written.append(path.read_bytes())
    if factor == 2.0**-130:
        # Denormal numbers are less precise.
        assert len(written[0]) == pytest.approx(len(written[1]), rel=0.1)
    else:
        assert written[0] == written[1]


@pytest.mark.parametrize("factor", [2.0**100, 2.0**-100, 2.0**-130])
def test_quaternions_of_any_size_are_rendered(tmp_path, factor):
    splats = scene(60, 1)
    expected = cogsplat.render(splats, ring()[0])
    extreme = replace(splats, quats=(splats.quats * factor).astype(np.float32))
    cogsplat.write(extreme, tmp_path / "a.ply")
    # Denormal numbers are less precise.
    tolerance = 1e-3 if factor == 2.0**-130 else 1e-5
    for given in (extreme, tmp_path / "a.ply"):
        np.testing.assert_allclose(cogsplat.render(given, ring()[0]), expected, atol=tolerance)


def test_quaternions_of_any_size_are_trained(tmp_path, monkeypatch):
    from cogsplat.codec.fit import tuning

    trained = []

    def record(splats, *_, **__):
        trained.append(splats)
        raise Cancelled

    monkeypatch.setattr(tuning, "tune", record)
    splats, cameras = scene(60), ring()
    splats.quats[:3] = [[0, 0, 2e30, 0], [0, -1e-40, 0, 0], [1, 0, 0, 0]]
    cogsplat.write(splats, tmp_path / "a.ply")
    for given in (splats, tmp_path / "a.ply"):
        with pytest.raises(Cancelled):
            cogsplat.tune(given, tmp_path / "a.cogs", cameras=cameras)
        np.testing.assert_array_equal(
            trained.pop().quats[:3], [[0, 0, 1, 0], [0, -1, 0, 0], [1, 0, 0, 0]]
        )


# Squares and exponentials of such values overflow, where numpy warns; cameras show few splats.
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize("names", [["sh0"], ["shN"], ["scales"], ["scales", "sh0", "shN"]])
def test_values_at_the_formats_limits_are_encoded_again(tmp_path, names, profile):
    signs = np.random.default_rng(5)
    splats = scene(60, 1)
    extreme = {
        name: signs.choice([-MAX_VALUE, MAX_VALUE], getattr(splats, name).shape).astype(np.float32)
        for name in names
    }
    config = replace(KEEP, profile=profile)
    found = replace(splats, **extreme)
    again = ""
    for name in ("once.cogs", "again.cogs"):
        try:
            cogsplat.encode(found, tmp_path / name, cameras=ring(), config=config)
        except DataError as error:
            again = error.code
            break
        found = cogsplat.decode(tmp_path / name)
        assert not found.invalid_rows().any()
    # The sum of two decoded values can be beyond the limit of one.
    assert again in ("", "value-range")
    assert (tmp_path / "once.cogs").exists()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_scenes_that_no_planned_view_shows(tmp_path):
    splats = replace(scene(60, 1), scales=np.full((60, 3), MAX_VALUE, np.float32))
    with pytest.raises(DataError) as caught:
        cogsplat.encode(splats, tmp_path / "out.cogs", preset="fast")
    assert caught.value.code == "value-range"
    archive = replace(KEEP, profile="near-lossless")
    cogsplat.encode(splats, tmp_path / "out.cogs", config=archive, preset="fast")
    assert (cogsplat.decode(tmp_path / "out.cogs").scales == np.float32(MAX_VALUE)).all()


def test_cameras_that_cannot_be_used_are_refused(tmp_path):
    splats, path = scene(50), tmp_path / "out.cogs"
    away = [replace(camera, translation=np.array([0.0, 0.0, -500.0])) for camera in ring()]
    for cameras, code in (([], "no-cameras"), (away, "cameras-see-nothing")):
        with pytest.raises(DataError) as caught:
            cogsplat.encode(splats, path, cameras=cameras)
        assert caught.value.code == code
    with pytest.raises(StorageError) as missing:
        cogsplat.encode(splats, path, cameras=tmp_path / "none.json")
    assert missing.value.code == "not-found"
    with pytest.raises(StorageError) as missing:
        cogsplat.encode(tmp_path / "none.ply", path)
    assert missing.value.code == "not-found"
    assert list(tmp_path.iterdir()) == []


def test_scores_of_another_scene_are_refused(tmp_path, made):
    _, splats, scores = made
    few = splats.take(slice(0, 20))
    with pytest.raises(DataError) as caught:
        cogsplat.encode(few, tmp_path / "out.cogs", request=scored(scores))
    assert caught.value.code == "scores-mismatch"
    assert list(tmp_path.iterdir()) == []


ENCODE = """
import sys
import numpy as np
sys.path.insert(0, "tests")
from test_facade import ring, scene
import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.scoring.score_config import ScoreConfig
threads = int(sys.argv[2])
for profile in ("transform", "vq"):
    config = EncodeConfig(profile=profile, chunk_splats=200, threads=threads)
    cogsplat.encode(scene(2500), f"{sys.argv[1]}-{profile}.cogs", cameras=ring(), config=config,
                    request=EncodeRequest(score_config=ScoreConfig(threads=threads)))
"""


@pytest.mark.slow
def test_threads_and_hash_seeds_change_no_byte_of_a_file(tmp_path):
    digests = set()
    for threads, seed in ((1, "0"), (2, "4321")):
        count = str(threads)
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": count,
            "OPENBLAS_NUM_THREADS": count,
            "MKL_NUM_THREADS": count,
            "PYTHONHASHSEED": seed,
        }
        target = tmp_path / f"threads-{count}"
        subprocess.run(
            [sys.executable, "-c", ENCODE, str(target), count],
            env=environment, cwd=ROOT, check=True,
        )  # fmt: skip
        files = [Path(f"{target}-{profile}.cogs") for profile in ("transform", "vq")]
        digests.add(tuple(hashlib.sha256(file.read_bytes()).hexdigest() for file in files))
    assert len(digests) == 1


# Decoding.


def test_parts_are_rows_of_the_whole(made):
    path, splats, _ = made
    whole = cogsplat.decode(path)
    with cogsplat.open(path) as file:
        counts = [int(count) for count in file.chunks.splats]
    assert sum(counts) == len(whole) == len(splats)
    assert len(counts) == 6
    ends = np.cumsum([0, *counts])
    for first in range(7):
        for last in range(first, 7):
            part = cogsplat.decode(path, chunks=(first, last))
            assert same(part, whole.take(slice(int(ends[first]), int(ends[last]))))
    for wanted in (0, 1, 50, 51, 299, 300, 10**9):
        part = cogsplat.decode(path, splats=wanted)
        expected = ends[np.searchsorted(ends, min(wanted, 300))]
        assert len(part) == expected
        assert same(part, whole.take(slice(0, int(expected))))


def test_the_degree_may_be_cut(made):
    path, *_ = made
    whole = cogsplat.decode(path)
    for degree in range(4):
        part = cogsplat.decode(path, sh_degree=degree)
        assert same(part, whole.with_sh_degree(degree))


def test_prefixes_decode_to_what_is_complete(made, tmp_path):
    path, *_ = made
    whole, data = cogsplat.decode(path), path.read_bytes()
    coarse = cogsplat.decode(path, refine=False)
    assert not same(coarse, whole)
    counts = []
    for share in (0.3, 0.5, 0.8, 1.0):
        size = round(share * len(data))
        part = cogsplat.decode(path, size_bytes=size)
        counts.append(len(part))
        fine = (part.means == whole.means[: len(part)]).all(axis=1)
        assert (fine | (part.means == coarse.means[: len(part)]).all(axis=1)).all()
        short = tmp_path / f"{size}.cogs"
        short.write_bytes(data[:size])
        with cogsplat.open(short, partial=True) as file:
            assert same(file.decode(), part)
        if size < len(data):
            with pytest.raises(TruncatedError):
                cogsplat.decode(short)
    assert counts == sorted(counts)
    assert counts[-1] == len(whole)
    assert same(cogsplat.decode(path, size_bytes=10**12), whole)
    for size in (0, 1, 63):
        with pytest.raises(TruncatedError):
            cogsplat.decode(path, size_bytes=size)


def test_sources_decode_as_paths_do(made):
    path, *_ = made
    whole = cogsplat.decode(path)
    assert same(cogsplat.decode(FileSource(path)), whole)
    assert same(cogsplat.decode(str(path), threads=2), whole)
    assert same(cogsplat.read(path), whole)


@pytest.mark.parametrize(
    "options",
    [
        {"chunks": (0, 1), "splats": 1},
        {"splats": 1, "size_bytes": 1000},
        {"chunks": (0, 7)},
        {"chunks": (3, 2)},
        {"chunks": (-1, 2)},
        {"splats": -1},
        {"size_bytes": -1},
        {"threads": -1},
        {"sh_degree": -1},
        {"sh_degree": 4},
    ],
)
def test_arguments_out_of_range_are_refused(made, options):
    with pytest.raises(ValueError, match=r"expected|more than one"):
        cogsplat.decode(made[0], **options)


def test_decoding_reports_and_may_be_stopped(made):
    calls = []
    cogsplat.decode(made[0], progress=lambda *call: calls.append(call))
    assert calls[-1][1] == calls[-1][2] > 0

    def stop(*call):
        raise Cancelled

    with pytest.raises(Cancelled):
        cogsplat.decode(made[0], progress=stop)


def test_what_is_no_cogs_file_is_refused(tmp_path):
    for name, data in (("empty", b""), ("text", b"hello\n" * 100), ("zeros", bytes(5000))):
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(FormatError):
            cogsplat.decode(path)
        with pytest.raises(FormatError):
            cogsplat.open(path)
    for path in (tmp_path / "none.cogs", tmp_path):
        with pytest.raises(StorageError):
            cogsplat.decode(path)


# Scenes of other formats.


@pytest.mark.parametrize("degree", range(4))
def test_scenes_are_written_and_read(tmp_path, degree):
    splats = scene(40, degree)
    path = tmp_path / "scene.ply"
    cogsplat.write(splats, path)
    assert same(cogsplat.read(path), splats)
    with pytest.raises(StorageError) as caught:
        cogsplat.write(splats, path)
    assert caught.value.code == "exists"
    cogsplat.write(splats.take(slice(0, 3)), path, force=True)
    assert len(cogsplat.read(path)) == 3


def test_what_no_format_takes_is_refused(tmp_path):
    for name in ("scene.cogs", "scene.xyz", "scene"):
        with pytest.raises(FormatError) as caught:
            cogsplat.write(scene(5), tmp_path / name)
        assert caught.value.code == "unknown-format"
    assert list(tmp_path.iterdir()) == []


def test_the_facade_names_what_it_gives():
    assert sorted(cogsplat.__all__) == cogsplat.__all__
    for name in cogsplat.__all__:
        assert getattr(cogsplat, name) is not None
    assert cogsplat.__version__


def test_the_namespace_is_what_it_exports():
    assert dir(cogsplat) == cogsplat.__all__


def test_results_have_short_reprs(made):
    path, splats, scores = made
    report = cogsplat.encode(splats, path, request=scored(scores), force=True)
    found = cogsplat.compare(splats, path, ring())
    with cogsplat.open(path) as file:
        for result in (splats, scores, report, found, file):
            assert len(repr(result)) < 200, repr(result)
    for result in (report, found):
        assert result._repr_html_().startswith("<table>")


def test_configurations_need_no_compiler():
    program = (
        "import sys, cogsplat; cogsplat.EncodeConfig(); cogsplat.EncodeRequest(); "
        "import cogsplat.codec.encode.presets; print('numba' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"


def test_importing_it_needs_no_compiler():
    done = subprocess.run(
        [sys.executable, "-c", "import cogsplat, sys; print('numba' in sys.modules)"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == "False"


def test_an_archive_may_show_nothing(tmp_path):
    dark = replace(scene(40), opacities=np.full(40, -20, np.float32))
    path = tmp_path / "dark.cogs"
    cogsplat.encode(dark, path, config=EncodeConfig(profile="near-lossless"))
    found = cogsplat.decode(path)
    assert len(found) == 40
    np.testing.assert_allclose(found.opacities, -20, atol=0.005)
    for profile in ("transform", "vq"):
        with pytest.raises(DataError) as caught:
            cogsplat.encode(dark, tmp_path / "other.cogs", config=EncodeConfig(profile=profile))
        assert caught.value.code == "empty-scene"
    assert not (tmp_path / "other.cogs").exists()


def test_files_in_memory_and_open_files_decode(made):
    path, _, _ = made
    whole = cogsplat.decode(path)
    data = path.read_bytes()
    with path.open("rb") as stream:
        for given in (data, memoryview(data), io.BytesIO(data), stream):
            again = cogsplat.decode(given)
            np.testing.assert_array_equal(again.means, whole.means)
        assert not stream.closed
    with cogsplat.open(data) as file:
        assert file.num_chunks >= 1
    with pytest.raises(TypeError, match="expected a path, bytes"):
        cogsplat.decode(3)


def test_quality_and_targets_are_plain_keywords(tmp_path):
    splats = scene(600)
    sizes = {}
    for name, options in (
        ("low", {"quality": 25.0}),
        ("high", {"quality": 45.0}),
        ("size", {"target": "9KiB"}),
        ("share", {"target": "20%"}),
        ("bytes", {"target": 9216}),
    ):
        path = tmp_path / f"{name}.cogs"
        report = cogsplat.encode(splats, path, cameras=ring(), preset="fast", **options)
        sizes[name] = path.stat().st_size
        assert report.size_bytes == sizes[name]
    assert sizes["low"] < sizes["high"]
    assert sizes["size"] == sizes["bytes"] <= 9216
    assert sizes["share"] <= splats.nbytes // 5
    with pytest.raises(ValueError, match="more than one of quality"):
        cogsplat.encode(splats, tmp_path / "x.cogs", quality=40, target="30dB")
    with pytest.raises(TypeError, match="a dict, expected Splats or the path of a scene"):
        cogsplat.encode({}, tmp_path / "x.cogs")


def test_what_encoding_takes_is_exported_late():
    program = (
        "import sys, cogsplat; assert 'cogsplat.codec.encode' not in sys.modules; "
        "print(cogsplat.EncodeConfig().profile, cogsplat.Target(size_bytes=5).size_bytes)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.split() == ["transform", "5"]
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = cogsplat.nothing
