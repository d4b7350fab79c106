import sys
from types import ModuleType

import oracle
import pytest

from cogsplat.codec.errors import MissingExtraError
from cogsplat.codec.render.cuda_device import cuda_device
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.scoring.score_config import ScoreConfig

ON_DEVICE = RenderConfig(device="cuda")


@pytest.mark.parametrize("missing", ["torch", "gsplat"])
def test_without_the_packages_the_extra_is_named(monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(MissingExtraError, match=r"cogsplat\[train\]") as refusal:
        render(oracle.scene(1, n=3), oracle.camera(), ON_DEVICE)
    assert refusal.value.code == "needs-extra"


@pytest.mark.parametrize("there", [False, True])
def test_without_a_device_or_its_compiler_nothing_is_drawn_elsewhere(monkeypatch, capsys, there):
    torch = pytest.importorskip("torch", reason="needs torch")
    pytest.importorskip("gsplat", reason="needs gsplat")
    backend = ModuleType("gsplat.cuda._backend")
    backend._C = None
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", backend)
    monkeypatch.setattr("gsplat.cuda._backend", backend, raising=False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    with pytest.raises(MissingExtraError, match="nvcc" if there else "finds no CUDA") as refusal:
        cuda_device()
    assert refusal.value.code == "no-cuda-device"
    assert refusal.value.exit_code == 4
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("config", [RenderConfig, ScoreConfig])
def test_devices_that_are_not_known_are_refused(config):
    with pytest.raises(ValueError, match="'gpu', expected one of"):
        config(device="gpu")
