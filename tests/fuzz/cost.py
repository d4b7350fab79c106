"""Print what files that are made to cost much do cost: bytes, peak memory, seconds, outcome.

Run as ``python tests/fuzz/cost.py`` (Linux). Memory is what the process grew by above a baseline in
which every reader has read a good file; each file has a process of its own.
"""

import gc
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"
sys.path[:0] = [str(ROOT), *(str(TESTS / name) for name in ("codec", "formats", "fuzz"))]

import hostile_files as hostile  # noqa: E402
from seeds import corpus  # noqa: E402
from targets import TARGETS, run_once  # noqa: E402

import cogsplat  # noqa: E402

MIB = 1 << 20

FILES: dict[str, Callable[[Path], Path]] = {
    "SOG, one entry for all images, 200 MiB each": lambda folder: hostile.sog_of_one_entry(
        folder, side=16, count=200, inflated=200 * MIB
    ),
    "SOG, 9 million splats of one colour": lambda folder: hostile.sog_of_one_entry(
        folder, side=3000, count=9_000_000, inflated=10 * MIB
    ),
    "SOG, 560,000 splats of one colour": lambda folder: hostile.sog_of_one_entry(
        folder, side=750, count=560_000, inflated=MIB
    ),
    "SOG, 200,000 entries": lambda folder: hostile.sog_of_many_entries(folder, entries=200_000),
    "glTF, 1000 primitives of 10,000 shared splats": lambda folder: (
        hostile.gltf_of_shared_accessors(folder, splats=10_000, primitives=1000)
    ),
    "glTF, 16 primitives of 3300 shared splats": lambda folder: hostile.gltf_of_shared_accessors(
        folder, splats=3300, primitives=16, degree=3
    ),
    ".gltf, 10 million empty arrays": lambda folder: hostile.gltf_of_empty_arrays(
        folder, arrays=10**7
    ),
    "SPZ 3, 3.5 million equal splats": lambda folder: hostile.spz_of_zeros(
        folder, version=3, splats=3_500_000
    ),
    "SPZ 4, 8 million equal splats": lambda folder: hostile.spz_of_zeros(
        folder, version=4, splats=8_000_000, padding=10**6
    ),
    "SPZ 4, 160,000 equal splats": lambda folder: hostile.spz_of_zeros(
        folder, version=4, splats=160_000
    ),
    "PLY, a million empty lists": lambda folder: hostile.ply_of_empty_lists(folder, lists=MIB),
    "cameras.json, 63 MB of empty arrays": lambda folder: hostile.cameras_json_of_empty_arrays(
        folder, size=63 * 10**6
    ),
    "cameras.json, 400,000 cameras": lambda folder: hostile.cameras_json_of_many(
        folder, cameras=400_000
    ),
    "COLMAP, 90,000 images": lambda folder: hostile.colmap(folder, images=90_000),
    "COLMAP, 500,000 images": lambda folder: hostile.colmap(folder, images=500_000),
    "COLMAP, a line of 100 MB": lambda folder: hostile.colmap_with_long_line(folder, size=10**8),
}


def _resident(key: str) -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(key))


def measure(path: Path) -> str:
    """Return a line of the table for a file, of the process that this is."""
    warnings.simplefilter("ignore")
    for target in TARGETS.values():
        for data in list(corpus(target.name).values())[:2]:
            run_once(target, data)
    is_scene = path.is_file() and path.suffix != ".json"
    gc.collect()
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    before, start = _resident("VmRSS"), time.perf_counter()
    try:
        found = len(cogsplat.read(path) if is_scene else cogsplat.read_cameras(path))
        outcome = f"{found:,} read"
    except cogsplat.CogsplatError as error:
        outcome = error.code
    seconds = time.perf_counter() - start
    return f"{(_resident('VmHWM') - before) / 1e6:.0f} MB | {seconds:.2f} s | {outcome}"


def main() -> None:
    """Measure every file, or the one that the command line names."""
    if len(sys.argv) > 1:
        print(measure(Path(sys.argv[1])))
        return
    for name, make in FILES.items():
        with tempfile.TemporaryDirectory() as folder:
            path = make(Path(folder))
            size = sum(file.stat().st_size for file in Path(folder).iterdir())
            line = subprocess.run(
                [sys.executable, __file__, str(path)], capture_output=True, text=True, check=True
            ).stdout
            print(f"{name} | {size / 1e6:.3f} MB | {line.strip()}", flush=True)


if __name__ == "__main__":
    main()
