"""Request of an encode: views, configuration, target and resources, validated once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.order.orders import split_name
from cogsplat.codec.views.trained_at import parse_trained_at
from cogsplat.codec.views.view_sets import at_width
from cogsplat.codec.views.view_text import parse_view, unit_up
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .config import EncodeConfig, Target
from .presets import DEFAULT_PRESET, PRESETS, Preset

if TYPE_CHECKING:
    from cogsplat.codec.scoring.contribution import Scores
    from cogsplat.codec.scoring.score_config import ScoreConfig
    from cogsplat.codec.segments.codebooks import EncodedCodebook


@dataclass(frozen=True, eq=False)
class EncodeRequest:
    """Inputs of an encode, except the scene.

    Parameters
    ----------
    cameras : sequence of Camera, optional
        Views to score in, in the frame of the means. None plans views around the splats.
    scores : Scores, optional
        Scores of an earlier `score` in `cameras`; they replace the scoring pass. Without `cameras`
        no compensation is fitted.
    test_views : sequence of Camera
        Views in which PSNR is measured and predicted. Empty for planned test views, or for some of
        `cameras`.
    stored_cameras : sequence of Camera
        Cameras stored in the file for its readers; they change nothing else.
    up : str or array-like of 3 float, optional
        Direction against gravity in the frame of the means, or its text (`view_text.parse_up`).
        None estimates it from the cameras or the splats.
    view : str or Camera, optional
        First view for viewers, or its text (`view_text.parse_view`). None chooses one.
    trained_at : str, optional
        Size and field of view of the pictures of training (`trained_at.parse_trained_at`), by which
        viewers draw splats as thick as in training. None takes those of the scene, else of
        `cameras`.
    shown_at : int, optional
        Width, px, of the pictures that the file is made for: all views are scored, and PSNR is
        measured, at this width. Viewpoints of training are taken from the cameras as given. None
        for the widths of the given cameras, or 400.
    config : EncodeConfig
        Contents of the file. With planned views, its nominal quality is the PSNR in the planned
        test views, to about 1 dB (`rate_control.search_nominal`).
    score_config : ScoreConfig, optional
        Scoring settings in place of the preset's.
    preset : str
        One of `presets.PRESETS`: numbers of views, effort of ordering and compensation.
    target : Target, optional
        PSNR or file size to search for; it replaces `EncodeConfig.quality_db`.
    basis : EncodedCodebook, optional
        Basis of colours of another file (`CogsFile.stored_codebook`) in place of a new one,
        only for the profile ``transform``: files with the same codebooks can be joined.
    memory_bytes : int, optional
        Resident-memory limit of the process. Larger arrays are kept in mapped files next to the
        output: for a scene given as the path of a PLY, with any profile but `vq`.
    workspace : Workspace
        Allocator of the arrays as long as the scene; `memory_bytes` chooses one by itself.
    executor : Executor, optional
        Runs the work of single views and chunks. None for threads of this process.

    Raises
    ------
    ValueError
        An unknown preset; the order ``gain`` with scores and no cameras; a target for the profile
        `near-lossless`; a basis of another attribute than colour, or for another profile than
        `transform`; an executor or a preview together with a memory limit.
    DataError
        ``bad-view-text``: `up`, `view` or `trained_at` cannot be parsed.

    Examples
    --------
    >>> from cogsplat.codec.encode.config import EncodeConfig, Target
    >>> request = EncodeRequest(config=EncodeConfig(profile="vq"), target=Target(psnr_db=35.0))
    >>> request.effort.planned_views
    96
    """

    cameras: Sequence[Camera] | None = None
    scores: Scores | None = None
    test_views: Sequence[Camera] = ()
    stored_cameras: Sequence[Camera] = ()
    up: str | ArrayLike | None = None
    view: str | Camera | None = None
    trained_at: str | None = None
    shown_at: int | None = None
    config: EncodeConfig = field(default_factory=EncodeConfig)
    score_config: ScoreConfig | None = None
    preset: str = DEFAULT_PRESET
    target: Target | None = None
    basis: EncodedCodebook | None = None
    memory_bytes: int | None = None
    workspace: Workspace = IN_MEMORY
    executor: Executor | None = None

    def __post_init__(self) -> None:
        if self.shown_at is not None and self.shown_at < 1:
            raise ValueError(f"shown at {self.shown_at} px, expected at least 1")
        if self.up is not None:
            unit_up(self.up)
        if isinstance(self.view, str):
            parse_view(self.view)
        if self.trained_at is not None:
            parse_trained_at(self.trained_at)
        if self.preset not in PRESETS:
            raise ValueError(f"preset {self.preset!r}, expected one of {tuple(PRESETS)}")
        gain = split_name(self.config.order)[0] == "gain"
        if self.scores is not None and not self.cameras and gain:
            raise ValueError(
                f"order {self.config.order!r} with scores and no cameras, expected the cameras "
                "that were scored, or an order that does not render, such as 'contribution'"
            )
        if self.target is not None and self.config.profile == "near-lossless":
            raise ValueError(
                "a target for the profile 'near-lossless', expected a profile for viewing"
            )
        if self.basis is not None:
            if self.config.profile != "transform":
                raise ValueError(
                    f"a basis for the profile {self.config.profile!r}, expected 'transform'"
                )
            if self.basis.attribute != "colour":
                raise ValueError(f"a basis of {self.basis.attribute}, expected colour")
        if self.memory_bytes is not None or self.workspace.in_files:
            if self.executor is not None:
                raise ValueError("an executor and a memory limit, expected one of them")
            if self.config.preview is not None:
                raise ValueError("a preview and a memory limit, expected one of them")

    def at_shown_width(self) -> EncodeRequest:
        """Return the request with all given views at the width of `shown_at`."""
        if self.shown_at is None:
            return self
        cameras = None if self.cameras is None else at_width(self.cameras, self.shown_at)
        return replace(self, cameras=cameras, test_views=at_width(self.test_views, self.shown_at))

    def with_stored_look(
        self, up: NDArray[np.float64] | None, view: Camera | None
    ) -> EncodeRequest:
        """Return the request with the up and the first view that the scene's file stores.

        A request with cameras, an up or a first view of its own stays as it is.
        """
        own = (self.cameras, self.up, self.view, self.config.ordering.first_view)
        return self if any(given is not None for given in own) else replace(self, up=up, view=view)

    @property
    def effort(self) -> Preset:
        """Settings of the preset that `preset` names."""
        return PRESETS[self.preset]

    @property
    def scoring(self) -> ScoreConfig:
        """Scoring settings: `score_config`, or the settings of the preset for the profile."""
        if self.score_config is not None:
            return self.score_config
        return self.effort.score_config(self.config.profile, threads=self.config.threads)

    @property
    def jitters(self) -> bool:
        """Whether given cameras are scored with jittered copies."""
        return self.score_config is None or self.score_config.jitter

    @property
    def view_executor(self) -> Executor | None:
        """Executor of single views; one thread for mapped arrays, to save memory."""
        return LocalThreads(1) if self.workspace.in_files else self.executor
