"""``cogsplat encode``: from a scene to a COGS file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

import cogsplat
from cogsplat.codec.chunking import DEFAULT_LARGEST, MAX_CHUNK_SPLATS
from cogsplat.codec.splats import MAX_SH_DEGREE
from cogsplat.formats.atomic import refuse_existing

from .cli_inputs import read_any, scoring_cameras, usable_rows
from .cli_options import (
    PATH,
    cameras_option,
    eval_every_option,
    force_option,
    jitter_option,
    json_option,
    quiet_option,
    threads_option,
    top_k_option,
)
from .cli_output import counted, facts, name_of, say, say_json, size_text
from .cli_progress import Stages

if TYPE_CHECKING:
    from cogsplat.codec.encoder import EncodeConfig
    from cogsplat.formats.cogs_reader import CogsFile

# The choices and defaults below are those of `EncodeConfig` and `PruneConfig`, which take a
# compiler to import; a test compares them.


@click.command(
    epilog="\b\nExample:\n"
    "  cogsplat encode scene.ply scene.cogs --cameras cameras.json --quality 38"
)
@click.argument("scene", type=PATH)
@click.argument("out", type=PATH, metavar="OUT.cogs")
@cameras_option("Without it, views are made up around the scene.")
@click.option(
    "--profile",
    type=click.Choice(["transform", "vq", "near"]),
    default="vq",
    show_default=True,
    help="transform, vq: for viewing, by a shared transform or by codebooks. near: every attribute "
    "within a bound, for archives.",
)
@click.option(
    "--quality",
    type=click.FloatRange(10, 90),
    default=36.0,
    show_default=True,
    metavar="DB",
    help="Nominal PSNR of the profiles for viewing.",
)
@click.option(
    "--order",
    type=click.Choice(["contribution", "source"]),
    default="contribution",
    show_default=True,
    help="Which splats come first.",
)
@click.option(
    "--chunk-splats",
    type=click.IntRange(1, MAX_CHUNK_SPLATS),
    default=DEFAULT_LARGEST,
    show_default=True,
    metavar="N",
    help="Most splats in a chunk.",
)
@click.option("--no-morton", is_flag=True, help="Keep the order inside chunks as well.")
@click.option(
    "--prune",
    type=click.FloatRange(0, 1, max_open=True),
    show_default="0.02",
    metavar="PEAK",
    help="Drop splats whose weight stays below PEAK in every pixel of every view.",
)
@click.option("--no-prune", is_flag=True, help="Keep every splat.")
@jitter_option
@top_k_option
@eval_every_option(0, "Keep from scoring the")
@click.option(
    "--sh",
    "sh_degree",
    type=click.IntRange(0, MAX_SH_DEGREE),
    metavar="0..3",
    help="Cut to this SH degree.",
)
@click.option("--drop-invalid", is_flag=True, help="Leave out splats with NaN or infinite values.")
@threads_option
@force_option
@quiet_option
@json_option
def encode(
    scene: Path,
    out: Path,
    cameras: Path | None,
    profile: str,
    quality: float,
    order: str,
    chunk_splats: int,
    no_morton: bool,
    prune: float | None,
    no_prune: bool,
    no_jitter: bool,
    top_k: int,
    eval_every: int,
    sh_degree: int | None,
    drop_invalid: bool,
    threads: int,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Encode SCENE into a progressive COGS file.

    Splats are scored from the cameras, put in the order of what they contribute, pruned, cut into
    chunks and compressed. The bytes do not depend on the number of threads.
    """
    from cogsplat.codec.encoder import EncodeConfig
    from cogsplat.codec.prune import PruneConfig
    from cogsplat.codec.score import ScoreConfig

    if prune is not None and no_prune:
        raise click.UsageError("--prune and --no-prune: expected one of them")
    bound = PruneConfig() if prune is None else PruneConfig(peak=prune)
    config = EncodeConfig(
        profile=profile,
        quality_db=quality,
        order=order,
        chunk_splats=chunk_splats,
        morton=not no_morton,
        prune=None if no_prune else bound,
        threads=threads,
    )
    refuse_existing(out, force=force)
    with Stages(shown=not (quiet or as_json)) as stages:
        with stages.stage("read"):
            views = scoring_cameras(cameras, eval_every)
            given = read_any(scene, threads=threads)
            splats = given.splats
            if sh_degree is not None:
                splats = splats.with_sh_degree(sh_degree)
            if drop_invalid:
                splats = usable_rows(splats, scene)
        size = cogsplat.encode(
            splats,
            out,
            cameras=views,
            config=config,
            score_config=ScoreConfig(top_k=top_k, jitter=not no_jitter, threads=threads),
            force=force,
            progress=stages,
        )
        stages("write", 1, 1)
    if quiet and not as_json:
        return
    with cogsplat.open(out) as file:
        report = _report(file, size, config, stages)
    rows_in, kept = given.file_splats, int(file.root.splats)
    dropped, pruned = rows_in - len(splats), len(splats) - kept
    if as_json:
        say_json(
            {
                "output": name_of(out),
                **report,
                "source_bytes": given.file_bytes,
                "ratio": round(given.file_bytes / size, 3),
                "splats_in": rows_in,
                "splats_dropped": dropped,
                "splats_pruned": pruned,
            }
        )
        return
    say(f"{out}: {size_text(size)}, {given.file_bytes / size:.1f} times smaller than {scene}")
    gone = f"{pruned:,} pruned" + (f", {dropped:,} invalid" if dropped else "")
    books = [f"{book.attribute} {book.rows:,}" for book in file.root.codebooks]
    facts(
        ("splats", f"{kept:,} of {rows_in:,} ({gone}), {size / max(kept, 1):.2f} B each"),
        ("chunks", f"{file.num_chunks}, SH degree {file.root.sh_degree}"),
        ("codebooks", f"{', '.join(books)} rows" if books else ""),
        ("scored", counted(stages.totals.get("score", 0), "view") + _with_copies(no_jitter)),
        ("time", stages.line()),
    )


def _with_copies(no_jitter: bool) -> str:
    return "" if no_jitter else ", jittered copies included"


def _report(file: CogsFile, size: int, config: EncodeConfig, stages: Stages) -> dict[str, object]:
    """Return what the new file holds and how it came about."""
    splats = file.root.splats
    return {
        "bytes": size,
        "splats": splats,
        "bytes_per_splat": round(size / max(splats, 1), 3),
        "sh_degree": file.root.sh_degree,
        "chunks": file.num_chunks,
        "codebooks": [
            {"attribute": book.attribute, "rows": book.rows} for book in file.root.codebooks
        ],
        "profile": config.profile,
        "order": config.order,
        "scored_views": stages.totals.get("score", 0),
        "seconds": stages.rounded(),
    }
