"""Checkpoints with other arrays than those of a run are refused, not met by a traceback."""

import numpy as np
import pytest

from cogsplat.codec.errors import FormatError
from cogsplat.codec.fit.differentiable_rendering import Gradients
from cogsplat.codec.fit.splat_adam import SplatAdam
from cogsplat.codec.fit.train_config import TrainConfig
from cogsplat.codec.fit.trainer import Trainer
from cogsplat.codec.fit.training_views import make_training_views
from cogsplat.codec.splats import Splats
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

SCENE = synth(50)


@pytest.fixture(scope="module")
def trainer() -> Trainer:
    return Trainer(SCENE, make_training_views(SCENE, synth_cameras(3, 16, 16)), TrainConfig())


def changes(state: dict[str, np.ndarray]) -> list[tuple[str, np.ndarray | None]]:
    """Return arrays to replace, one at a time: missing, of other lengths, axes and types."""
    found: list[tuple[str, np.ndarray | None]] = []
    for name, values in state.items():
        found += [(name, None), (name, values[..., None]), (name, values.astype("U9"))]
        found += [(name, values.astype(bool))]
        found += [(name, values[:-1])] if values.ndim else [(name, np.array(-1))]
        found += [(name, values.swapaxes(0, -1))] if values.ndim > 1 and values.size else []
    return found


def test_a_trainer_refuses_other_arrays(trainer: Trainer) -> None:
    state = {name: np.array(values) for name, values in trainer.state().items()}
    before = trainer.splats
    for name, values in changes(state):
        other = {**state, name: values} if values is not None else dict(state)
        if values is None:
            del other[name]
        elif values.shape == state[name].shape and values.dtype == state[name].dtype:
            continue
        with pytest.raises(FormatError) as error:
            trainer.restore(other)
        assert error.value.code == "bad-checkpoint", name
        # Nothing is restored of a checkpoint that is refused.
        assert trainer.splats is before
    trainer.restore(state)


def test_moments_are_those_of_the_scene(trainer: Trainer) -> None:
    fewer: Splats = SCENE.take(np.arange(20))
    with pytest.raises(FormatError, match="moments of 20 splats, expected 50"):
        SplatAdam.from_state(SplatAdam(fewer).state(), SCENE)
    whole = SplatAdam.from_state(SplatAdam(SCENE).state(), SCENE)
    assert all(f"adam_means.{name}" in whole.state() for name in Gradients.names())
