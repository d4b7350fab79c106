"""Options of ``cogsplat encode``, and the request that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.config import EncodeConfig, Target
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.errors import DataError
from cogsplat.codec.order.chunk_plan import DEFAULT_CHUNK_SPLATS
from cogsplat.codec.partition.nested_cells import DEFAULT_CELL_SPLATS
from cogsplat.codec.rate.pruning import PruneConfig
from cogsplat.codec.segments.codebooks import EncodedCodebook
from cogsplat.codec.workspace import Workspace
from cogsplat.formats.cogs.open_file import open_scene
from cogsplat.formats.storage.byte_counts import ByteCount
from cogsplat.tools.terminal.limits_option import current_limits
from cogsplat.tools.terminal.output_names import COGS, HTML, check_name
from cogsplat.tools.terminal.usage import usage_errors
from cogsplat.tools.terminal.values import Colour
from cogsplat.tools.workflow.inputs import load_cameras
from cogsplat.tools.workflow.order_options import OrderChoice
from cogsplat.tools.workflow.output_files import check_outputs
from cogsplat.tools.workflow.scene_edits import SceneEdits


@dataclass(frozen=True)
class EncodeOptions:
    """Values of the options of ``encode``."""

    scene: Path
    out: Path
    cameras: Path | None
    profile: str
    quality: float
    target_psnr: float | None
    target_size: ByteCount | None
    preset: str
    choice: OrderChoice
    chunk_splats: int | None
    cells: bool
    no_view_table: bool
    no_morton: bool
    no_refine: bool
    no_compensation: bool
    preview: float | None
    prune: float | None
    no_prune: bool
    no_extras: bool
    up: str | None
    trained_at: str | None
    shown_at: int | None
    store_cameras: bool
    no_jitter: bool
    top_k: int | None
    eval_every: int
    measure: bool
    report: Path | None
    images: Path | None
    memory: int | None
    basis_of: Path | None
    describe: Path | None
    format_name: str | None
    background: Colour
    edits: SceneEdits
    device: str
    threads: int
    scheduler: str | None
    force: bool
    quiet: bool
    as_json: bool

    @property
    def measures(self) -> bool:
        """Whether to measure the PSNR and SSIM of the new file; --report and --images imply it."""
        return self.measure or self.report is not None or self.images is not None

    def require_consistent(self) -> None:
        """Refuse contradictory options and unwritable outputs.

        `EncodeConfig` and `EncodeRequest` refuse the rest.
        """
        _require_one_aim(self.profile, self.target_psnr, self.target_size)
        if self.prune is not None and self.no_prune:
            raise click.UsageError("--prune and --no-prune: expected one of them")
        if self.no_extras and self.choice.by_object:
            raise click.UsageError("--no-extras and --objects: expected one of them")
        if self.store_cameras and self.cameras is None:
            raise click.UsageError("--store-cameras without --cameras, expected cameras to store")
        if self.images is not None and self.shown_at is not None:
            raise click.UsageError(
                "--images and --shown-at: expected photos in the size of --cameras"
            )
        if self.scheduler is not None and self.memory is not None:
            raise click.UsageError("--memory and --scheduler: expected one of them")
        if self.scheduler is not None and self.device == "cuda":
            raise click.UsageError("--device cuda and --scheduler: expected one of them")
        if self.memory is not None and self.measures:
            raise click.UsageError(
                "--memory with --measure, --report or --images, expected `cogsplat compare` "
                "afterwards: measuring holds two scenes in memory"
            )
        check_name(self.out, COGS, insisted=self.format_name is not None)
        if self.report is not None:
            check_name(self.report, HTML)
        check_outputs(self.out, self.report, force=self.force)

    def request(self) -> EncodeRequest:
        """Return the request without the parts that depend on the scene and its cameras."""
        bound = PruneConfig(peak=self.prune)
        with usage_errors():
            config = EncodeConfig(
                profile=self.profile,
                quality_db=self.quality,
                order=self.choice.name,
                ordering=self.choice.ordering,
                chunk_splats=self.chunk_splats
                or (DEFAULT_CELL_SPLATS if self.cells else DEFAULT_CHUNK_SPLATS),
                cells=self.cells,
                view_table=not self.no_view_table,
                morton=not self.no_morton,
                refine=not self.no_refine,
                compensate=not self.no_compensation,
                preview=self.preview,
                prune=None if self.no_prune else bound,
                threads=self.threads,
            )
            target = None if self.target_psnr is None else Target(psnr_db=self.target_psnr)
            return EncodeRequest(
                config=config,
                preset=self.preset,
                target=target,
                basis=self._basis(),
                memory_bytes=self.memory,
            )

    def _basis(self) -> EncodedCodebook | None:
        """Return the basis of ``--basis-of``; None where that file has no codebooks."""
        if self.basis_of is None:
            return None
        with open_scene(self.basis_of, limits=current_limits()) as file:
            books = file.root.codebooks
            if len(books) > 1 or any(book.attribute != "colour" for book in books):
                raise DataError(
                    "basis-mismatch",
                    f"{self.basis_of}: {len(books)} codebooks, expected one of colour, as a "
                    "file of the profile transform has",
                )
            return file.stored_codebook(0) if books else None

    def complete(
        self,
        request: EncodeRequest,
        views: Sequence[Camera] | None,
        file_bytes: int,
        workspace: Workspace,
    ) -> EncodeRequest:
        """Return the request with the parts that depend on the scene and its cameras.

        These are the scored and test views, the scoring settings and the target size.

        Parameters
        ----------
        request : EncodeRequest
            Result of `request`.
        views : sequence of Camera or None
            Cameras to score in, after the edits.
        file_bytes : int
            Size of the scene's file, for a target size in per cent.
        workspace : Workspace
            Allocator that the scene was read with.
        """
        numbered = []
        if self.cameras is not None:
            numbered = [self.edits.camera(view) for view in load_cameras(self.cameras)]
        target = request.target
        with usage_errors():
            if self.target_size is not None:
                target = Target(size_bytes=self.target_size.uncapped(file_bytes))
            view = self.choice.first_view(numbered)
            scoring = request.effort.score_config(
                self.profile, top_k=self.top_k, jitter=not self.no_jitter, threads=self.threads
            )
            return replace(
                request,
                cameras=views,
                up=self.up,
                trained_at=self.trained_at,
                shown_at=self.shown_at,
                view=view,
                score_config=replace(scoring, device=self.device),
                target=target,
                stored_cameras=numbered if self.store_cameras else (),
                workspace=workspace,
                memory_bytes=None,
            )


def _require_one_aim(
    profile: str, target_psnr: float | None, target_size: ByteCount | None
) -> None:
    """Refuse more than one of quality, target PSNR and target size."""
    aims = {"--target-psnr": target_psnr, "--target-size": target_size}
    named = [option for option, value in aims.items() if value is not None]
    context = click.get_current_context()
    if context.get_parameter_source("quality") is not click.core.ParameterSource.DEFAULT:
        named.append("--quality")
    if len(named) > 1:
        raise click.UsageError(f"{' and '.join(named)}: expected one of them")
    if profile == "near-lossless" and named and named != ["--quality"]:
        raise click.UsageError(
            f"{named[0]} with --profile near-lossless, expected a profile for viewing"
        )
