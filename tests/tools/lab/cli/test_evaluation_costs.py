"""One bar over the whole of eval, bench, compare and export-html: what is planned is what works."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from running import Run, SmallScene

from cogsplat.codec.progress import StageCost
from cogsplat.tools.terminal.progress_bars import Stages


class Watched:
    """Stages that were planned, stages that were reported after that, and the share each time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.planned: list[StageCost] = []
        self.reported: list[str] = []
        self.shares: list[float] = []
        plan, report = Stages.plan, Stages.__call__

        def planned(stages: Stages, costs: Sequence[StageCost]) -> None:
            plan(stages, costs)
            self.planned = list(costs)

        def reported(stages: Stages, stage: str, done: int, total: int) -> None:
            report(stages, stage, done, total)
            if stages.share is not None:
                self.reported.append(stage)
                self.shares.append(stages.share)

        monkeypatch.setattr(Stages, "plan", planned)
        monkeypatch.setattr(Stages, "__call__", reported)

    def expected(self, costs: Sequence[StageCost]) -> set[str]:
        """Return the names of stages, those inside stages included."""
        found = set()
        for cost in costs:
            found |= {cost.stage} | {part for step in cost.parts for part in self.expected(step)}
        return found


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    return Watched(monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "lab evaluate {ply} --cameras {cameras} --orders contribution,gain --shares 20,50 "
        "--sizes 50% --codecs splat --out {out}",
        "lab evaluate {ply} --cameras {cameras} --file {cogs} --shares none",
        "lab evaluate {ply} --cameras {cameras} --orders source --sizes none --eval-every 4",
        "lab bench {ply} --cameras {cameras} --profiles vq,near --qualities 30 --formats splat",
        "compare {ply} {cogs} --cameras {cameras}",
        "export-html {ply} {out}.html",
    ],
    ids=lambda words: words.partition(" ")[0],
)
def test_the_bar_goes_from_nothing_to_the_whole(
    run: Run, small: SmallScene, tmp_path: Path, watched: Watched, words: str
) -> None:
    paths = {"ply": small.ply, "cogs": small.cogs, "cameras": small.cameras}
    arguments = [word.format(**paths, out=tmp_path / "out") for word in words.split()]
    told = run(*arguments)
    assert told.code == 0, told.err
    assert watched.shares[0] == 0.0
    assert watched.shares == sorted(watched.shares)
    assert watched.shares[-1] > 0.99
    assert len(set(watched.shares)) >= 5
    # What every file goes through, and nothing else but what has no cost and trials of a search.
    expected = watched.expected(watched.planned)
    assert expected - {"write"} <= set(watched.reported)
    trial = {"chunks", "codebooks", "quantisers"} if "search" in expected else set()
    assert set(watched.reported) - expected - trial <= {"strips", "write", "order"}


def test_an_ablation_is_one_stage(
    run: Run, small: SmallScene, watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cogsplat.tools.lab.benchmark import ablation

    few = dict(list(ablation.changes(3).items())[:2])
    monkeypatch.setattr(ablation, "changes", lambda degree: few)
    told = run("lab bench", small.ply, "--cameras", small.cameras, "--ablation", "--qualities", 30)
    assert told.code == 0, told.err
    assert [cost.stage for cost in watched.planned] == ["score", "ablation"]
    assert watched.planned[1].steps == 3
    assert watched.shares[-1] == 1.0
