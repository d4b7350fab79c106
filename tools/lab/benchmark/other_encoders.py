"""Comparison with third-party encoders: time, size, and the size of COGS at equal PSNR.

Run ``python -m cogsplat.tools.lab.benchmark.other_encoders SCENE --cameras PATH --out DIR``
after, in ``tools/web``, ``npm install --no-save @playcanvas/splat-transform@2``. PlayCanvas'
converter writes SOG, Streamed SOG, SPZ and compressed PLY on the CPU. The npz of Niedermayr et al.
is written by `c3dgs_npz`. Every file is decoded and compared with the source in held-out views.
Then ``cogsplat encode`` targets the PSNR of each file.

Times are those of complete processes, from a PLY to a closed file, run one after the other.
"""

from __future__ import annotations

import csv
import io
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import click

import cogsplat
from cogsplat.codec.scoring.view_quality import mean_psnr_db, view_qualities
from cogsplat.codec.splats import Splats, concatenate
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.cameras.inria import write_cameras_json
from cogsplat.formats.scenes.ply.ply_scene import write_ply
from cogsplat.formats.storage.atomic import atomic_write
from cogsplat.tools.lab.crosscheck import converter
from cogsplat.tools.terminal.standard_streams import PATH, WRITTEN_PATH

_MODULES: Final = Path(__file__).resolve().parents[2] / "web" / "node_modules"
_MODULE: Final = "cogsplat.tools.lab.benchmark.other_encoders"
_HELD_OUT: Final = 8
# Splats in each level of Streamed SOG, percent: the usual three levels.
_LEVELS: Final = (100, 50, 25)

PRESETS: Final = ("fast", "balanced")
"""Presets of ``cogsplat encode`` that are compared at the PSNR of every other file."""


@dataclass(frozen=True)
class EncodeResult:
    """Time, size and quality of an encoded scene.

    Parameters
    ----------
    name : str
        Name of the encoder.
    seconds : float
        Duration of the encoder's process.
    size_bytes : int
        Size of all files; for Streamed SOG all levels.
    held_out_db : float
        Mean PSNR of the held-out views against renders of the source.
    like : str
        For COGS, the name of the encoder whose PSNR was the target; else empty.
    """

    name: str
    seconds: float
    size_bytes: int
    held_out_db: float
    like: str = ""


@dataclass(frozen=True)
class Encoder:
    """An encoder: its command line and a reader of its output.

    Parameters
    ----------
    name : str
        Name for the results.
    command : callable
        Returns the command line for a PLY, cameras and the output file.
    target : str
        Name of the output file in an empty folder.
    read : callable
        Reads the scene from that folder.
    """

    name: str
    command: Callable[[Path, Path, Path], list[str]]
    target: str
    read: Callable[[Path], Splats]


def encoders(node_modules: Path, sh_iterations: int = 10) -> list[Encoder]:
    """Return the encoders for comparison.

    Parameters
    ----------
    node_modules : Path
        Folder with ``@playcanvas/splat-transform``; without it only the npz encoder is returned.
    sh_iterations : int
        Iterations of SH clustering in SOG; the converter's default is 10.
    """
    found = [Encoder("c3dgs-style npz", _npz_command, "scene.npz", _read_npz)]
    if not converter.is_installed(node_modules):
        return found
    start = converter.command(node_modules, "-g", "cpu", "-i", str(sh_iterations))

    def plain(scene: Path, cameras: Path, target: Path) -> list[str]:
        return [*start, str(scene), str(target)]

    def streamed(scene: Path, cameras: Path, target: Path) -> list[str]:
        levels: list[str] = []
        for level, share in enumerate(_LEVELS):
            reduced = [] if share == 100 else ["-F", f"{share}%"]
            levels += [str(scene), *reduced, "-l", str(level)]
        return [*start, *levels, str(target)]

    return [
        Encoder("SPZ", plain, "scene.spz", _read_only_file),
        Encoder("compressed PLY", plain, "scene.compressed.ply", _read_only_file),
        *found,
        Encoder("SOG", plain, "scene.sog", _read_only_file),
        Encoder("Streamed SOG", streamed, "lod-meta.json", _read_finest_level),
    ]


def _npz_command(scene: Path, cameras: Path, target: Path) -> list[str]:
    """Return the command line that writes a scene as `c3dgs_npz` by running this module."""
    arguments = ["--write-npz", str(target), "--cameras", str(cameras), str(scene)]
    return [sys.executable, "-m", _MODULE, *arguments]


def _read_npz(folder: Path) -> Splats:
    """Read the scene that the encoder wrote as ``scene.npz`` in a folder."""
    from . import c3dgs_npz

    return c3dgs_npz.read(folder / "scene.npz")


def _read_only_file(folder: Path) -> Splats:
    """Read the single scene file of a folder."""
    (path,) = folder.iterdir()
    return cogsplat.read(path)


def _read_finest_level(folder: Path) -> Splats:
    """Read level 0 of a Streamed SOG: concatenate its parts, the folders ``0_*``."""
    return concatenate([cogsplat.read(part / "meta.json") for part in sorted(folder.glob("0_*"))])


def run_timed(command: list[str]) -> float:
    """Run a command and return its duration, s.

    Raises
    ------
    click.ClickException
        The command failed; the message ends with its output.
    """
    start = time.perf_counter()
    converter.run(command)
    return time.perf_counter() - start


def compare(
    scene: Path,
    cameras: Path,
    quality_db: Callable[[Splats], float],
    others: Sequence[Encoder],
    presets: Sequence[str] = PRESETS,
) -> Iterator[EncodeResult]:
    """Encode a scene by third-party encoders, then by COGS at equal PSNR.

    Parameters
    ----------
    scene : Path
        Path of a PLY.
    cameras : Path
        Training views, without the held-out ones.
    quality_db : callable
        Returns the mean PSNR of a scene in held-out views.
    others : sequence of Encoder
    presets : sequence of str
        Presets of ``cogsplat encode``.

    Yields
    ------
    EncodeResult
        Result of each encoder, followed by the results of the presets at the encoder's PSNR.

    Raises
    ------
    click.ClickException
        A command failed.
    """
    for other in others:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "made"
            folder.mkdir()
            seconds = run_timed(other.command(scene, cameras, folder / other.target))
            size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
            found = EncodeResult(other.name, seconds, size, quality_db(other.read(folder)))
            yield found
            for preset in presets:
                path = Path(name) / f"{preset}.cogs"
                start = [sys.executable, "-m", "cogsplat.tools.main", "encode", "--quiet"]
                aim = ["--preset", preset, "--target-psnr", f"{found.held_out_db:.2f}"]
                seconds = run_timed(
                    [*start, str(scene), str(path), "--cameras", str(cameras), *aim]
                )
                size, db = path.stat().st_size, quality_db(cogsplat.decode(path))
                yield EncodeResult(f"COGS {preset}", seconds, size, db, like=other.name)


def _write_npz(scene: Path, cameras: Path, target: Path) -> None:
    """Score a scene and write it as `c3dgs_npz`; runs in the process of `_npz_command`."""
    from cogsplat.codec.scoring.contribution import score
    from cogsplat.codec.scoring.score_config import ScoreConfig

    from . import c3dgs_npz

    splats = cogsplat.read(scene)
    scores = score(splats, read_cameras(cameras), ScoreConfig(sensitivity_every=1))
    c3dgs_npz.write(splats, scores, target)


@click.command()
@click.argument("scene", type=PATH)
@click.option("--cameras", type=PATH, required=True)
@click.option("--out", type=WRITTEN_PATH, help="Folder for a CSV table.")
@click.option("--node-modules", type=PATH, default=_MODULES, help="Folder with splat-transform.")
@click.option("--only", default="", help="Encoders to run, separated by commas.")
@click.option(
    "--sh-iterations", default=10, show_default=True, help="Iterations of SH clustering in SOG."
)
@click.option("--write-npz", type=WRITTEN_PATH, hidden=True)
def main(
    scene: Path, cameras: Path, out: Path | None, node_modules: Path, only: str,
    sh_iterations: int, write_npz: Path | None,
) -> None:  # fmt: skip
    """Compare encoders of SCENE: time, and bytes at equal PSNR."""
    if write_npz is not None:
        _write_npz(scene, cameras, write_npz)
        return
    views, held_out = hold_out(read_cameras(cameras), _HELD_OUT)
    source = cogsplat.read(scene)
    others = encoders(node_modules, sh_iterations)
    wanted = [name.strip() for name in only.split(",") if name.strip()]
    others = [other for other in others if not wanted or other.name in wanted]
    if not others:
        raise click.BadParameter(
            f"{only!r}, expected names of available encoders", param_hint="--only"
        )
    rows: list[EncodeResult] = []

    def quality_db(splats: Splats) -> float:
        return mean_psnr_db(view_qualities(source, splats, held_out))

    with tempfile.TemporaryDirectory() as name:
        ply, given = Path(name) / "scene.ply", Path(name) / "cameras.json"
        write_ply(source, ply)
        write_cameras_json(views, given)
        for found in compare(ply, given, quality_db, others):
            rows.append(found)
            click.echo(json.dumps(asdict(found)))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        page = io.StringIO()
        writer = csv.DictWriter(page, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
        with atomic_write(out / "other-encoders.csv", force=True) as file:
            file.write(page.getvalue().encode())


if __name__ == "__main__":
    main()
