"""Checkpoints in the formats of gsplat and nerfstudio."""

from pathlib import Path

import numpy as np
import pytest
from torch_files import Named, Storage, saved, tensor

import cogsplat
from cogsplat.codec.errors import FormatError, LimitError
from cogsplat.formats.storage.limits import Limits

SHAPES = {"means": (5, 3), "scales": (5, 3), "quats": (5, 4), "opacities": (5,)}
GSPLAT = {**SHAPES, "sh0": (5, 1, 3), "shN": (5, 15, 3)}
NERFSTUDIO = {
    **SHAPES, "opacities": (5, 1), "features_dc": (5, 3), "features_rest": (5, 8, 3)
}  # fmt: skip


def arrays(shapes):
    rng = np.random.default_rng(7)
    return {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def write(path, wrap, made, prefix=""):
    state = {f"{prefix}{name}": tensor(str(k), a) for k, (name, a) in enumerate(made.items())}
    storages = {str(k): a.tobytes() for k, a in enumerate(made.values())}
    saved(path, wrap(state), storages)


@pytest.mark.parametrize(
    ("shapes", "name", "wrap", "prefix"),
    [
        (GSPLAT, "ckpt_29999_rank0.pt", lambda state: {"step": 29999, "splats": state}, ""),
        (GSPLAT, "splats.pth", lambda state: state, ""),
        (
            NERFSTUDIO,
            "step-000029999.ckpt",
            lambda state: {"step": 29999, "pipeline": state, "optimizers": {}},
            "_model.gauss_params.",
        ),
    ],
)
def test_checkpoints_are_scenes(tmp_path: Path, shapes, name, wrap, prefix):
    made = arrays(shapes)
    write(tmp_path / name, wrap, made, prefix)
    splats = cogsplat.read(tmp_path / name)
    dc = made["sh0"][:, 0] if "sh0" in made else made["features_dc"]
    rest = made.get("shN", made.get("features_rest"))
    for field, expected in (
        ("means", made["means"]),
        ("scales", made["scales"]),
        ("quats", made["quats"]),
        ("opacities", made["opacities"].reshape(5)),
        ("sh0", dc),
        ("shN", rest),
    ):
        np.testing.assert_array_equal(getattr(splats, field), expected, field)


def test_other_tensors_are_not_read(tmp_path: Path):
    made = arrays(GSPLAT)
    state = {name: tensor(str(k), a) for k, (name, a) in enumerate(made.items())}
    storages = {str(k): a.tobytes() for k, a in enumerate(made.values())}
    # The storage of the optimiser's state is not even there.
    lost = tensor("99", np.zeros((5, 3), np.float32))
    saved(tmp_path / "a.pt", {"splats": state, "optimizers": {"means": lost}}, storages)
    assert len(cogsplat.read(tmp_path / "a.pt")) == 5


@pytest.mark.parametrize(
    ("wrap", "code"),
    [
        (lambda state: {"splats": {k: v for k, v in state.items() if k != "quats"}},
         "missing-array"),
        (lambda state: {"weights": state}, "torch-file"),
        (lambda state: {**state, "evil": Named("os", "system")}, "torch-file"),
        (lambda state: {**state, "means": Storage("0", 4)}, "torch-file"),
        (lambda state: {**state, "quats": state["means"]}, "bad-shape"),
    ],
)  # fmt: skip
def test_other_files_are_no_checkpoints(tmp_path: Path, wrap, code):
    write(tmp_path / "a.pt", wrap, arrays(GSPLAT))
    with pytest.raises(FormatError, match=r"a\.pt") as caught:
        cogsplat.read(tmp_path / "a.pt")
    assert caught.value.code == code


def test_limits_hold(tmp_path: Path):
    write(tmp_path / "a.pt", lambda state: state, arrays(GSPLAT))
    with pytest.raises(LimitError):
        cogsplat.read(tmp_path / "a.pt", limits=Limits(splats=4))
