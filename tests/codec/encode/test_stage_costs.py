"""What stages cost: those that an encode reports are those expected, in their order."""

import oracle
import pytest

from cogsplat.codec.encode import pipeline
from cogsplat.codec.encode.config import EncodeConfig, Target
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.encode.stage_costs import order_costs, render_cost, score_cost, stage_costs
from cogsplat.codec.fit.preview_training import PreviewConfig, TrainedPreview
from cogsplat.codec.progress import OverallProgress
from cogsplat.codec.scoring.contribution import zero_scores

SHORT = PreviewConfig(share=0.1, round_steps=2, quantised_steps=2, threads=1)


def views(count):
    return [oracle.camera(angle=number / count) for number in range(count)]


@pytest.mark.parametrize(
    ("preset", "given", "target", "profile", "preview"),
    [
        ("balanced", True, None, "transform", None),
        ("balanced", True, None, "transform", TrainedPreview(SHORT)),
        ("fast", True, Target(psnr_db=35.0), "vq", None),
        ("fast", True, Target(psnr_db=35.0), "vq", TrainedPreview(SHORT)),
        ("fast", True, Target(size_bytes=6000), "transform", None),
        ("fast", False, None, "vq", None),
    ],
)
def test_the_stages_are_those_that_an_encode_reports(preset, given, target, profile, preview):
    splats = oracle.scene(5, n=300)
    request = EncodeRequest(
        cameras=views(4) if given else None,
        config=EncodeConfig(
            profile=profile,
            chunk_splats=32,
            preview=None if preview is None else SHORT.share,
            threads=1,
        ),
        preset=preset,
        target=target,
    )
    costs = stage_costs(len(splats), request)
    shares, stages = [], []
    whole = OverallProgress(costs, lambda stage, *_: stages.append(stage), shares.append)
    pipeline.encode(
        splats,
        request,
        size_of=lambda encoded: 20 * encoded.splats,
        preview=preview,
        progress=whole,
    )
    whole("write", 1, 1)
    expected = [cost.stage for cost in costs]
    inner = {"chunks", "codebooks", "quantisers"} if target or not given else set()
    assert list(dict.fromkeys(stage for stage in stages if stage not in inner)) == expected
    assert all(cost.cost > 0.0 for cost in costs)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(set(shares)) > len(costs)


def test_costs_grow_with_splats_views_and_pixels():
    def total(splats, cameras):
        costs = stage_costs(splats, EncodeRequest(cameras=cameras))
        return sum(cost.total() for cost in costs)

    small = total(1000, views(8))
    assert total(100_000, views(8)) > small
    assert total(1000, views(16)) > small
    wide = [oracle.camera(width=640, height=480)] * 8
    assert total(1000, wide) > small
    assert render_cost(1000, wide) > render_cost(1000, views(8)) > 0.0


def test_scores_that_are_there_cost_nothing():
    costs = stage_costs(100, EncodeRequest(cameras=views(3), preset="fast"), scored=True)
    assert "score" not in [cost.stage for cost in costs]
    config = EncodeConfig(order="contribution")
    alone = stage_costs(100, EncodeRequest(config=config, scores=zero_scores(100), preset="fast"))
    assert [cost.stage for cost in alone] == ["order", "quantisers", "chunks", "write"]


def test_scoring_and_sorting_alone_cost_what_they_cost_in_an_encode():
    preset, cameras = PRESETS["balanced"], views(20)
    whole = {c.stage: c for c in stage_costs(900, EncodeRequest(cameras=cameras))}
    assert score_cost(900, preset, cameras) == whole["score"]
    assert order_costs(900, "gain", cameras) == [whole["reference views"], whole["gain"]]
    assert order_costs(900, "contribution", cameras) == []
