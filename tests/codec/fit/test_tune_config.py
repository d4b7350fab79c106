import subprocess
import sys

import pytest

from cogsplat.codec.fit.tune_config import TuneConfig, TuneRequest
from cogsplat.codec.fit.tuning_views import TuningViews


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"keep": 0.0}, "keep 0.0"),
        ({"round_keep": 1.0}, "round_keep 1.0"),
        ({"quantised_steps": 0}, "at least 1 each"),
        ({"rate_weight": -1.0}, "rate_weight -1.0"),
        ({"seconds": 0.0}, "0.0 seconds"),
        ({"preset": "slow"}, "preset 'slow'"),
        ({"preview": 1.0}, "preview 1.0"),
        ({"profile": "near-lossless"}, "profile 'near-lossless'"),
    ],
)
def test_invalid_settings_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        TuneConfig(**settings)


def test_photos_of_planned_views_are_refused():
    with pytest.raises(ValueError, match="photos for planned views"):
        TuneRequest(TuningViews((), origin="planned"), photos=())


def test_configurations_import_without_numba():
    modules = ("fit.train_config", "fit.tune_config", "encode.config", "encode.request")
    lines = ["import sys", "sys.modules.update(dict.fromkeys(('numba', 'scipy', 'sklearn')))"]
    lines += [f"import cogsplat.codec.{module}" for module in modules]
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
