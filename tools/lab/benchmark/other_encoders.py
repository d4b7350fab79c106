"""How long others' encoders take, how many bytes they write, and what COGS needs for that quality.

Run ``python -m cogsplat.tools.lab.benchmark.other_encoders SCENE --cameras PATH --out DIR``
after, in ``tools/web``, ``npm install --no-save @playcanvas/splat-transform@2``. PlayCanvas'
converter writes SOG, Streamed SOG, SPZ and compressed PLY from the PLY, on the processor;
Niedermayr et al.'s npz is ours, written from their description (`c3dgs_npz`). Every file is
read back and compared with the source in views that no encoder was given. Then ``cogsplat
encode`` aims at the PSNR of each.

All are timed as whole processes, from a PLY to a closed file, one after the other, in one run.
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
from cogsplat.tools.terminal.standard_streams import PATH

_MODULES: Final = Path(__file__).resolve().parents[2] / "web" / "node_modules"
_MODULE: Final = "cogsplat.tools.lab.benchmark.other_encoders"
_HELD_OUT: Final = 8
# Streamed SOG holds the scene in levels of detail; these shares of the splats are its usual three.
_LEVELS: Final = (100, 50, 25)

PRESETS: Final = ("fast", "balanced")
"""Presets of ``cogsplat encode`` that aim at the quality of every other file."""


@dataclass(frozen=True)
class Written:
    """A file that an encoder wrote, and how good it is.

    Parameters
    ----------
    name : str
    seconds : float
        From the start of the process to its end.
    size_bytes : int
        Of all files written; of Streamed SOG this counts every level.
    held_out_db : float
        Mean PSNR of the held-out views against renders of the source.
    like : str
        The file whose PSNR was aimed at; empty for those of other encoders.
    """

    name: str
    seconds: float
    size_bytes: int
    held_out_db: float
    like: str = ""


@dataclass(frozen=True)
class Encoder:
    """A command that encodes a scene, and what reads the files it leaves.

    Parameters
    ----------
    name : str
    command : callable
        Gives the command line, from the PLY, the cameras and the file to write.
    target : str
        Name of that file in a folder of its own.
    read : callable
        Reads the scene back from that folder.
    """

    name: str
    command: Callable[[Path, Path, Path], list[str]]
    target: str
    read: Callable[[Path], Splats]


def encoders(node_modules: Path, sh_iterations: int = 10) -> list[Encoder]:
    """Return the encoders that are compared with.

    Parameters
    ----------
    node_modules : Path
        Where ``@playcanvas/splat-transform`` is installed; without it only our npz is written.
    sh_iterations : int
        Of the clustering of SH in SOG; the converter's own default is 10.
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
    arguments = ["--write-npz", str(target), "--cameras", str(cameras), str(scene)]
    return [sys.executable, "-m", _MODULE, *arguments]


def _read_npz(folder: Path) -> Splats:
    from . import c3dgs_npz

    return c3dgs_npz.read(folder / "scene.npz")


def _read_only_file(folder: Path) -> Splats:
    (path,) = folder.iterdir()
    return cogsplat.read(path)


def _read_finest_level(folder: Path) -> Splats:
    """Join the parts of level 0, which lie in folders named LEVEL_PART."""
    return concatenate([cogsplat.read(part / "meta.json") for part in sorted(folder.glob("0_*"))])


def timed(command: list[str]) -> float:
    """Run a command and return its seconds.

    Raises
    ------
    click.ClickException
        It failed; the message ends with what it said.
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
) -> Iterator[Written]:
    """Encode a scene with others' encoders and, aiming at the PSNR of each, with ours.

    Parameters
    ----------
    scene : Path
        A PLY.
    cameras : Path
        Views for encoders that take any, none of those that are judged.
    quality_db : callable
        Gives the mean PSNR of a scene in held-out views.
    others : sequence of Encoder
    presets : sequence of str
        Of ``cogsplat encode``.

    Yields
    ------
    Written
        Of each encoder, then of each preset that aimed at its PSNR.

    Raises
    ------
    click.ClickException
        A command failed.
    """
    for other in others:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "made"
            folder.mkdir()
            seconds = timed(other.command(scene, cameras, folder / other.target))
            size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
            found = Written(other.name, seconds, size, quality_db(other.read(folder)))
            yield found
            for preset in presets:
                path = Path(name) / f"{preset}.cogs"
                start = [sys.executable, "-m", "cogsplat.tools.main", "encode", "--quiet"]
                aim = ["--preset", preset, "--target-psnr", f"{found.held_out_db:.2f}"]
                seconds = timed([*start, str(scene), str(path), "--cameras", str(cameras), *aim])
                size, db = path.stat().st_size, quality_db(cogsplat.decode(path))
                yield Written(f"COGS {preset}", seconds, size, db, like=other.name)


def _write_npz(scene: Path, cameras: Path, target: Path) -> None:
    from cogsplat.codec.scoring.contribution import ScoreConfig, score

    from . import c3dgs_npz

    splats = cogsplat.read(scene)
    scores = score(splats, read_cameras(cameras), ScoreConfig(sensitivity_every=1))
    c3dgs_npz.write(splats, scores, target)


@click.command()
@click.argument("scene", type=PATH)
@click.option("--cameras", type=PATH, required=True)
@click.option("--out", type=PATH, help="Folder for figures.")
@click.option("--node-modules", type=PATH, default=_MODULES, help="Where splat-transform is.")
@click.option("--only", default="", help="Names of encoders, separated by commas.")
@click.option("--sh-iterations", default=10, show_default=True, help="Of SOG's clustering.")
@click.option("--write-npz", type=PATH, hidden=True)
def main(
    scene: Path, cameras: Path, out: Path | None, node_modules: Path, only: str,
    sh_iterations: int, write_npz: Path | None,
) -> None:  # fmt: skip
    """Compare others' encoders of SCENE with ours: seconds, and bytes at equal PSNR."""
    if write_npz is not None:
        _write_npz(scene, cameras, write_npz)
        return
    views, held_out = hold_out(read_cameras(cameras), _HELD_OUT)
    source = cogsplat.read(scene)
    others = encoders(node_modules, sh_iterations)
    wanted = [name.strip() for name in only.split(",") if name.strip()]
    others = [other for other in others if not wanted or other.name in wanted]
    if not others:
        raise click.BadParameter(f"{only!r}, none of these is there", param_hint="--only")
    rows: list[Written] = []

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
