"""Quality of a scene in pictures of several sizes and distances, by how thick splats are drawn.

Run ``python -m cogsplat.tools.lab.benchmark.picture_sizes SCENE --cameras CAMERAS --eval-every 8``.
It prints the PSNR of the scene in smaller pictures and from further away, and that of prefixes of
a file that ``encode --preset fast`` makes of it. The ground truth has the pixels of training: the
usual picture at full size, averaged to the smaller size; or of a camera that is N times as far
away, the usual picture with N times the width and height, averaged. The drawings are:

- usual: 0.3 px² added to every projected covariance, whatever the picture;
- antialiased: the same, with opacities lowered by the growth of the splats (Mip-Splatting);
- as trained: by the capture viewpoints (SPEC 8.7), which are those of the cameras.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import Capture, capture_of_cameras
from cogsplat.codec.fit.downscaling import downscale_picture
from cogsplat.codec.metrics import psnr
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.render.visible_depth import visible_depth
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import hold_out
from cogsplat.tools.terminal.output import print_line, print_table

F32 = NDArray[np.float32]

FACTORS: Final = (2, 4, 8)
"""Reductions of the pictures per axis, and factors of the distance."""

SHARES: Final = (0.05, 0.15, 0.5, 1.0)
"""Shares of the splats in the measured prefixes."""

USUAL, ANTIALIASED, AS_TRAINED = "usual", "antialiased", "as trained"


@dataclass(frozen=True)
class Shot:
    """A camera, and the picture that it should show.

    Parameters
    ----------
    camera : Camera
    truth : (H, W, 3) float32
        Ground truth of the camera's size.
    """

    camera: Camera
    truth: F32


def drawings(splats: Splats, capture: Capture) -> dict[str, Splats]:
    """Return a scene marked for each drawing, by the name of the drawing.

    Parameters
    ----------
    splats : Splats
        Scene trained with the usual drawing.
    capture : Capture
        Viewpoints of training.
    """
    usual = replace(splats.info, capture=())
    infos = {
        USUAL: usual,
        ANTIALIASED: replace(usual, antialiased=True),
        AS_TRAINED: replace(usual, capture=capture),
    }
    return {name: replace(splats, info=info) for name, info in infos.items()}


def smaller_shots(usual: Splats, cameras: Sequence[Camera], factor: int) -> list[Shot]:
    """Return shots of smaller pictures, with the averaged full pictures as ground truth.

    Parameters
    ----------
    usual : Splats
        Source scene, without capture viewpoints.
    cameras : sequence of Camera
        Cameras of full size.
    factor : int
        Reduction per axis.
    """
    return [
        Shot(camera.downscaled(factor), downscale_picture(render(usual, camera), factor))
        for camera in cameras
    ]


def further_shots(usual: Splats, cameras: Sequence[Camera], factor: int) -> list[Shot]:
    """Return shots from further away, with averaged larger pictures as ground truth.

    Parameters
    ----------
    usual : Splats
        Source scene, without capture viewpoints.
    cameras : sequence of Camera
        Cameras at the distance of training.
    factor : int
        Factor of the distance, and of the size of the pictures that are averaged.
    """
    shots = []
    for camera in cameras:
        moved = moved_back(camera, factor, visible_depth(usual, camera))
        larger = moved.resized(moved.width * factor, moved.height * factor)
        shots.append(Shot(moved, downscale_picture(render(usual, larger), factor)))
    return shots


def moved_back(camera: Camera, factor: float, depth: float) -> Camera:
    """Move a camera back along its axis, until what lies at a depth is `factor` times as far."""
    return replace(
        camera, translation=camera.translation + np.array([0.0, 0.0, (factor - 1.0) * depth])
    )


def mean_psnr(splats: Splats, shots: Iterable[Shot], threads: int = 0) -> float:
    """Return the mean PSNR of a scene in shots, dB."""
    config = RenderConfig(threads=threads)
    return float(np.mean([psnr(render(splats, shot.camera, config), shot.truth) for shot in shots]))


def drawing_rows(
    splats: Splats, capture: Capture, tests: Sequence[Camera], threads: int = 0
) -> list[tuple[str, ...]]:
    """Return a table row per drawing: PSNR in smaller pictures, then from further away, dB.

    Parameters
    ----------
    splats : Splats
        Source scene.
    capture : Capture
        Viewpoints of training.
    tests : sequence of Camera
        Test views of full size.
    threads : int
        Number of threads, 0 for all cores.
    """
    ways = drawings(splats, capture)
    found: Mapping[str, list[str]] = {name: [] for name in ways}
    for make_shots in (smaller_shots, further_shots):
        for factor in FACTORS:
            shots = make_shots(ways[USUAL], tests, factor)
            for name, scene in ways.items():
                found[name].append(f"{mean_psnr(scene, shots, threads):.1f}")
    return [(name, *cells) for name, cells in found.items()]


def prefix_rows(
    file: cogsplat.CogsFile, splats: Splats, tests: Sequence[Camera], threads: int = 0
) -> list[tuple[str, ...]]:
    """Return a table row per prefix of a file: PSNR at each size, as usual / as trained, dB.

    Prefixes end with the chunk that brings them nearest to their share of the splats, and are
    compensated.

    Parameters
    ----------
    file : CogsFile
        File with capture viewpoints.
    splats : Splats
        Scene from which the file was encoded.
    tests : sequence of Camera
        Test views of full size.
    threads : int
        Number of threads, 0 for all cores.
    """
    usual = drawings(splats, ())[USUAL]
    sizes = [smaller_shots(usual, tests, factor) for factor in (1, *FACTORS)]
    counts = np.cumsum(file.chunks.splats)
    rows = []
    for share in SHARES:
        chunks = int(np.argmin(np.abs(counts - share * counts[-1]))) + 1
        prefix = file.decode(range(chunks), compensate=True, threads=threads)
        ways = drawings(prefix, file.root.info.capture)
        cells = [
            " / ".join(
                f"{mean_psnr(ways[name], shots, threads):.1f}" for name in (USUAL, AS_TRAINED)
            )
            for shots in sizes
        ]
        rows.append((f"{share:.0%}", f"{len(prefix):,}", *cells))
    return rows


def main() -> None:
    """Measure a scene given on the command line and print two tables."""
    parser = argparse.ArgumentParser(description=__doc__, prog="picture_sizes")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--eval-every", type=int, default=8, help="0: judge in all cameras")
    parser.add_argument("--threads", type=int, default=0)
    given = parser.parse_args()
    splats = cogsplat.read(given.scene).without_extras().drop_invalid()
    train, tests = hold_out(cogsplat.read_cameras(given.cameras), given.eval_every)
    tests = tests or train
    print_line(f"{given.scene}: PSNR in {len(tests)} views, dB")
    heads = ("drawn", *(f"1/{factor}" for factor in FACTORS), *(f"{n} x as far" for n in FACTORS))
    print_table(heads, drawing_rows(splats, capture_of_cameras(train), tests, given.threads))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.cogs"
        config = cogsplat.EncodeConfig(threads=given.threads)
        size = cogsplat.encode(splats, path, cameras=train, preset="fast", config=config).size_bytes
        with cogsplat.open(path) as file:
            rows = prefix_rows(file, splats, tests, given.threads)
    print_line(f"prefixes of a file of {size:,} bytes, drawn {USUAL} / {AS_TRAINED}:")
    print_table(("prefix", "splats", *(f"1/{factor}" for factor in (1, *FACTORS))), rows)


if __name__ == "__main__":
    main()
