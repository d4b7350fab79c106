"""Encode scenes of which no view is drawn: through the pipeline, with scores that are given."""

from dataclasses import replace

from cogsplat.codec.encode import pipeline
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.scoring.contribution import zero_scores

# Orders by gain draw the scene; compensation is fitted to pictures of it.
UNSEEN = EncodeConfig(order="contribution", compensate=False)


def unseen(**changes) -> EncodeConfig:
    """Return a configuration that looks at no view, with some other settings."""
    return replace(UNSEEN, **changes)


def encode(splats, scores=None, config=UNSEEN, **options) -> EncodedScene:
    """Encode a scene whose splats count what `scores` says, or all the same."""
    known = zero_scores(len(splats)) if scores is None else scores
    hooks = {name: options.pop(name) for name in ("size_of", "progress") if name in options}
    request = EncodeRequest(scores=known, config=config, **options)
    return pipeline.encode(splats, request, **hooks)
