"""The table of tuning without each of its parts, on a scene of a few hundred splats."""

from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.fit.tune_config import TuneConfig
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.tools.lab.benchmark import tuning_ablation
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

SHORT = TuneConfig(round_steps=2, recovery_steps=10, quantised_steps=4)


def test_every_variant_differs_in_what_it_is_named_after() -> None:
    found = {variant.name: variant for variant in tuning_ablation.variants(SHORT, 0.4, photos=True)}
    assert len(found) == 11
    assert found["default"].config == SHORT
    assert found["1.5 times as many splats"].config.keep == pytest.approx(0.6)
    # 0.6² is below 0.4: one cut is followed by the steps of two rounds.
    assert found["one pruning step instead of rounds"].config.round_steps == 2 * SHORT.round_steps
    assert found["noise instead of quantisers"].config == replace(
        SHORT, train=replace(SHORT.train, noise=True)
    )
    assert [name for name, variant in found.items() if variant.photos] == ["photos as ground truth"]
    assert len(tuning_ablation.variants(SHORT, 0.4, photos=False)) == 10


@pytest.mark.slow
def test_the_table_has_a_row_for_each_variant_at_one_size() -> None:
    splats = synth(1000, seed=1)
    train, tests = hold_out(synth_cameras(6, 48, 36), 8)
    photos = [
        [np.clip(render(splats, view), 0, 1).astype(np.float32) for view in views]
        for views in (train, tests)
    ]
    rows = tuning_ablation.measure(
        splats, train, tests, 9_000, SHORT, photos=(photos[0], photos[1])
    )
    assert [row[0] for row in rows] == [
        variant.name for variant in tuning_ablation.variants(SHORT, 0.4, photos=True)
    ]
    by_name = {row[0]: row for row in rows}
    for row in rows:
        assert 0.9 * 9_000 < int(row[2].replace(",", "")) <= 9_000
        # The photos are the source's pictures.
        assert float(row[6]) == pytest.approx(float(row[3]), abs=0.02)
    # In so few and small pictures a scene is learnt by heart, in fewer of them even more.
    assert float(by_name["half of the views"][3]) < float(by_name["default"][3]) - 1.0


@pytest.mark.slow
def test_some_variants_are_run_over_the_background_that_photos_have() -> None:
    splats = synth(600, seed=1)
    train, tests = hold_out(synth_cameras(6, 48, 36), 8)
    pink = (0.6, 0.0, 0.4)
    photos = [
        [np.clip(render(splats, view, RenderConfig(background=pink)), 0, 1) for view in views]
        for views in (train, tests)
    ]
    rows = tuning_ablation.measure(
        splats,
        train,
        tests,
        6_000,
        SHORT,
        photos=(photos[0], photos[1]),
        background=pink,
        only=["photos as ground truth"],
    )
    assert [row[0] for row in rows] == ["photos as ground truth"]
    # The photos are the source's pictures over this background.
    assert float(rows[0][6]) == pytest.approx(float(rows[0][3]), abs=0.02)


def test_a_variant_that_does_not_exist_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["tuning_ablation", "--only", "magic"])
    with pytest.raises(SystemExit):
        tuning_ablation.main()
    assert "expected some of ['default'" in capsys.readouterr().err
