"""order, and what it does for encode and decode: permutations, first views, objects, masks."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import SPLATS, VIEWS, Run, SmallScene

import cogsplat
from cogsplat.codec.order.objects import with_labels
from cogsplat.codec.order.orders import ORDERS, OrderConfig, OrderInputs, needs_scores, order_rows
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.tools.lab.synthetic.object_masks import synth_masks
from cogsplat.tools.lab.synthetic.terrace import OBJECTS, synth, synth_cameras, synth_objects
from cogsplat.tools.workflow.order_options import parse_budgets, parse_order


@pytest.fixture(scope="module")
def labelled(small: SmallScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small scene with its three objects labelled."""
    path = tmp_path_factory.mktemp("labelled") / "scene.ply"
    cogsplat.write(with_labels(synth(SPLATS), synth_objects(SPLATS)), path)
    return path


@pytest.mark.parametrize(
    "name", ["contribution", "octree-quota", "octree-adaptive", "sgss", "source", "random"]
)
def test_order_writes_a_permutation(run: Run, small: SmallScene, tmp_path: Path, name: str) -> None:
    out = tmp_path / "rows.npy"
    told = run("lab order", small.ply, out, "--cameras", small.cameras, "--order", name, "--json")
    assert (told.code, told.err) == (0, "")
    rows = np.load(out)
    assert rows.dtype == np.int64
    splats, cameras = cogsplat.read(small.ply), cogsplat.read_cameras(small.cameras)
    scene = OrderInputs(splats, score(splats, cameras), cameras)
    np.testing.assert_array_equal(rows, order_rows(name, scene))
    assert told.json["order"] == name
    assert told.json["scored_views"] == (3 * VIEWS if needs_scores(name) else 0)
    assert run("lab order", small.ply, out, "--cameras", small.cameras).code == 2, (
        "is there already"
    )


def test_order_serves_a_first_view(run: Run, small: SmallScene, tmp_path: Path) -> None:
    splats, cameras = cogsplat.read(small.ply), cogsplat.read_cameras(small.cameras)
    train = [camera for index, camera in enumerate(cameras) if index % 3]
    scene = OrderInputs(splats, score(splats, train, ScoreConfig(jitter=False)), train)
    common = ["--cameras", small.cameras, "--no-jitter", "--eval-every", 3, "--view", 3]
    for more, name, config in (
        (
            ["--order", "contribution+first-view"],
            "contribution+first-view",
            OrderConfig(first_view=cameras[3]),
        ),
        (
            ["--order", "opacity+frustum", "--frustum-share", 0.5],
            "opacity+frustum",
            OrderConfig(first_view=cameras[3], frustum_share=0.5),
        ),
    ):
        out = tmp_path / f"{name}.npy"
        told = run("lab order", small.ply, out, *common, *more)
        assert told.code == 0, told.err
        assert name in told.out
        np.testing.assert_array_equal(np.load(out), order_rows(name, scene, config))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--order", "gloss"], "expected one of"),
        (["--view", "99"], "expected an index of 0 to"),
        (["--frustum-share", "0.5"], "followed by"),
        (["--order", "sgss+first-view", "--view", "1", "--frustum-share", "1"], "followed by"),
        (["--object-budgets", "50"], "expected a share"),
    ],
)
def test_orders_that_make_no_sense_are_usage(
    run: Run, small: SmallScene, tmp_path: Path, arguments: list[str], message: str
) -> None:
    told = run("lab order", small.ply, tmp_path / "o.npy", "--cameras", small.cameras, *arguments)
    assert told.code == 2
    assert message in told.err
    assert not list(tmp_path.iterdir())


def test_names_and_budgets_are_read() -> None:
    for name in ORDERS:
        assert parse_order(f"{name}+first-view") == f"{name}+first-view"
    assert parse_budgets("20%") == ((None, 0.2),)
    assert parse_budgets("1:50%, 22:2.5%") == ((1, 0.5), (22, 0.025))


def test_encode_takes_orders_and_the_first_view(
    run: Run, small: SmallScene, tmp_path: Path
) -> None:
    out = tmp_path / "out.cogs"
    arguments = ["--cameras", small.cameras, "--profile", "near-lossless", "--no-morton", "--json"]
    told = run("encode", small.ply, out, *arguments, "--order", "antimatter+first-view",
               "--view", 2)  # fmt: skip
    assert told.code == 0, told.err
    assert told.json["order"] == "antimatter+first-view"
    camera = cogsplat.read_cameras(small.cameras)[2]
    with cogsplat.open(out) as file:
        first = file.root.first_view
    assert first is not None
    np.testing.assert_allclose(first.translation, camera.translation, rtol=1e-6)


def test_each_object_loads_alone(
    run: Run, small: SmallScene, labelled: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.cogs"
    arguments = ["--cameras", small.cameras, "--objects", "--no-prune", "--chunk-splats", 128]
    told = run("encode", labelled, out, *arguments, "--object-budgets", "10%")
    assert told.code == 0, told.err
    truth = synth_objects(SPLATS)
    for label in range(len(OBJECTS) + 1):
        alone = tmp_path / f"{label}.ply"
        told = run("decode", out, alone, "--object", label, "--json")
        assert told.code == 0, told.err
        splats = cogsplat.read(alone)
        assert len(splats) == (truth == label).sum()
        assert set(splats.extras["object"].ravel().tolist()) == {label}
        part = cogsplat.decode(out, objects=[label], splats=1)
        np.testing.assert_array_equal(part.means, splats.means[: len(part)])
        assert len(part) <= 128
    both = cogsplat.decode(out, objects=[1, 3])
    assert len(both) == np.isin(truth, (1, 3)).sum()
    listed = run("info", out, "--json").json["chunk_table"]
    assert isinstance(listed, list)
    held = dict.fromkeys(range(len(OBJECTS) + 1), 0)
    for chunk in listed:
        held[chunk["object"]] += chunk["splats"]
    assert list(held.values()) == np.bincount(truth).tolist()
    assert "object" in run("info", out).out
    assert "object" not in run("info", small.cogs).out
    told = run("decode", out, tmp_path / "none.ply", "--object", 9)
    assert told.code == 2
    assert "expected one of 0, 1, 2, 3" in told.err


def test_order_ranks_objects(run: Run, small: SmallScene, labelled: Path, tmp_path: Path) -> None:
    out = tmp_path / "rows.npy"
    arguments = ["--cameras", small.cameras, "--object-budgets", "100%", "--json"]
    told = run("lab order", labelled, out, *arguments)
    assert told.code == 0, told.err
    ranked = told.json["objects"]
    assert isinstance(ranked, list)
    shares = [entry["share_of_contribution"] for entry in ranked]
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) == pytest.approx(1.0, abs=1e-4)
    labels = synth_objects(SPLATS)[np.load(out)]
    starts = np.flatnonzero(np.diff(labels.astype(int), prepend=-1))
    assert labels[starts].tolist() == [entry["object"] for entry in ranked], "one after the other"


def test_objects_need_labels(run: Run, small: SmallScene, tmp_path: Path) -> None:
    by_cameras = ["--objects", "--cameras", small.cameras]
    for command, out in (("encode", "o.cogs"), ("lab order", "o.npy")):
        told = run(command, small.ply, tmp_path / out, *by_cameras)
        assert told.code == 3
        assert "[no-objects]" in told.err
        assert "score" not in told.err, "refused before the work"


def test_a_budget_for_what_is_not_there_is_refused_before_the_work(
    run: Run, small: SmallScene, labelled: Path, tmp_path: Path
) -> None:
    for command, out in (("encode", "o.cogs"), ("lab order", "o.npy")):
        arguments = ["--cameras", small.cameras, "--object-budgets", "9:20%"]
        told = run(command, labelled, tmp_path / out, *arguments)
        assert told.code == 3
        assert "[object-missing]" in told.err
        assert "score" not in told.err


def test_masks_label_what_they_show(run: Run, small: SmallScene, tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    splats, cameras = synth(SPLATS), synth_cameras(VIEWS, 64, 48)
    drawn = synth_masks(splats, synth_objects(SPLATS), cameras)
    for camera, mask in list(zip(cameras, drawn, strict=True))[1:]:
        Image.fromarray(mask).save(masks / f"{camera.name}.png")
    out = tmp_path / "out.cogs"
    arguments = [
        "--cameras",
        small.cameras,
        "--masks",
        masks,
        "--no-prune",
        "--profile",
        "near-lossless",
    ]
    told = run("encode", small.ply, out, *arguments)
    assert told.code == 0, told.err
    with cogsplat.open(out) as file:
        held = {int(label) for label in file.chunks.object}
    assert held == {0, 1, 2, 3}
    assert len(cogsplat.decode(out, objects=[1])) == pytest.approx(
        (synth_objects(SPLATS) == 1).sum(), rel=0.15
    )
    assert run("lab order", small.ply, tmp_path / "o.npy", "--masks", masks).code == 2, "no cameras"


def test_masks_that_fit_no_camera_are_refused(run: Run, small: SmallScene, tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    arguments = ["lab order", small.ply, tmp_path / "o.npy", "--cameras", small.cameras]
    assert run(*arguments, "--masks", masks).code == 4
    masks.mkdir()
    told = run(*arguments, "--masks", masks)
    assert (told.code, "[no-masks]" in told.err) == (3, True)
    wrong = {
        "size": Image.new("L", (32, 48)),
        "mode": Image.new("RGB", (64, 48)),
    }
    for name, picture in wrong.items():
        picture.save(masks / "view_00.png")
        told = run(*arguments, "--masks", masks)
        assert (told.code, "[mask]" in told.err) == (3, True), name
    (masks / "view_00.png").write_bytes(b"nothing of a picture")
    assert "[mask]" in run(*arguments, "--masks", masks).err


def test_synth_labels_and_draws_its_objects(run: Run, tmp_path: Path) -> None:
    out, masks = tmp_path / "scene.ply", tmp_path / "masks"
    told = run("lab synth", out, "--splats", 600, "--objects", "--masks", masks, "--json")
    assert told.code == 0, told.err
    labels = cogsplat.read(out).extras["object"]
    np.testing.assert_array_equal(labels.ravel(), synth_objects(600))
    with Image.open(masks / "view_00.png") as picture:
        assert picture.mode == "L"
        assert picture.size == (480, 360)
        assert set(np.unique(np.asarray(picture)).tolist()) <= {0, 1, 2, 3}
    assert len(list(masks.iterdir())) == 48
