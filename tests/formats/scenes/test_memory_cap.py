import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import cogsplat
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.memory import memory_need
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.errors import LimitError, UnsupportedError
from cogsplat.codec.workspace import IN_MEMORY
from cogsplat.formats.scenes.memory_cap import working_memory
from cogsplat.formats.storage.scratch_files import ScratchFiles
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CONFIG = EncodeConfig(threads=2)
SPLATS = 70_000
PRESETS = ("fast", "balanced")
# Runs a capped encode and prints the most memory that the process ever had, kB.
CAPPED = """
import sys, cogsplat
from pathlib import Path
source, out, cameras, preset, cap = sys.argv[1:]
request = cogsplat.EncodeRequest(preset=preset, memory_bytes=int(cap))
cogsplat.encode(source, out, cameras=cameras, request=request)
status = Path("/proc/self/status").read_text()
print(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from cogsplat.formats.cameras.inria import write_cameras_json

    folder = tmp_path_factory.mktemp("capped")
    cogsplat.write(synth(SPLATS), folder / "scene.ply")
    write_cameras_json(synth_cameras(3, 64, 48), folder / "cameras.json")
    for preset in PRESETS:
        out = folder / f"{preset}.cogs"
        cogsplat.encode(folder / "scene.ply", out, cameras=folder / "cameras.json", preset=preset)
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what is resident")
@pytest.mark.parametrize("preset", PRESETS)
def test_a_capped_encode_stays_below_its_cap_and_gives_the_same_bytes(folder, preset):
    need = memory_need(SPLATS, 3, CONFIG, extra_bytes=12)
    cap = need.out_of_core + 20_000_000
    assert need.out_of_core < cap < need.in_memory
    capped = folder / f"{preset}-capped.cogs"
    files = [str(path) for path in (folder / "scene.ply", capped, folder / "cameras.json")]
    done = subprocess.run(
        [sys.executable, "-c", CAPPED, *files, preset, str(cap)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert capped.read_bytes() == (folder / f"{preset}.cogs").read_bytes()
    assert int(done.stdout) * 1024 <= cap


def encode_capped(folder, memory_bytes, config=CONFIG):
    request = EncodeRequest(config=config, preset="fast", memory_bytes=memory_bytes)
    cogsplat.encode(folder / "scene.ply", folder / "no.cogs", request=request)


def test_a_cap_that_is_too_small_is_refused_before_anything_is_read(folder):
    with pytest.raises(LimitError, match="expected at least") as refused:
        encode_capped(folder, 100_000_000)
    assert refused.value.code == "memory-cap"
    config = replace(CONFIG, profile="vq")
    with pytest.raises(LimitError, match="profile vq"):
        encode_capped(folder, 300_000_000, config)
    assert not (folder / "no.cogs").exists()


def test_scenes_in_memory_count_towards_the_cap(folder):
    scene = cogsplat.read(folder / "scene.ply")
    with working_memory(folder / "scene.ply", CONFIG, 500_000_000, folder) as mapped:
        assert mapped.in_files
    with pytest.raises(LimitError) as refused, working_memory(scene, CONFIG, 500_000_000, folder):
        pytest.fail("16 MB of splats were not counted")
    assert refused.value.code == "memory-cap"
    cogs = folder / "fast.cogs"
    with cogsplat.open(cogs) as file:
        rows = file.root.splats
    need = memory_need(rows, 3, CONFIG, held_bytes=236 * rows)
    with pytest.raises(LimitError), working_memory(cogs, CONFIG, need.out_of_core - 1, folder):
        pytest.fail("a COGS file is decoded in memory")
    with working_memory(scene, CONFIG, None, folder) as free:
        assert free is IN_MEMORY


def test_other_formats_do_not_say_how_much_they_hold(folder):
    cogsplat.write(synth(500), folder / "scene.spz")
    with (
        pytest.raises(UnsupportedError) as refused,
        working_memory(folder / "scene.spz", CONFIG, 10**9, folder),
    ):
        pytest.fail("a cap for SPZ")
    assert refused.value.code == "memory-cap-format"


def test_extras_are_mapped_as_well(tmp_path):
    scene = synth(70_000, sh_degree=1)
    labels = np.random.default_rng(3).integers(0, 5, len(scene)).astype(np.int32)
    cogsplat.write(replace(scene, extras={"object": labels}), tmp_path / "scene.ply")
    config = replace(CONFIG, profile="near-lossless")
    views = synth_cameras(2, 64, 48)
    for name, workspace in (("a.cogs", None), ("b.cogs", "mapped")):
        with ScratchFiles(tmp_path, 1 << 20) as files:
            kept = replace(IN_MEMORY, zeros=files.zeros, in_files=True, trim=files.evict)
            cogsplat.encode(
                tmp_path / "scene.ply",
                tmp_path / name,
                cameras=views,
                config=config,
                request=EncodeRequest(workspace=kept if workspace else IN_MEMORY),
            )
    assert (tmp_path / "a.cogs").read_bytes() == (tmp_path / "b.cogs").read_bytes()
    np.testing.assert_array_equal(
        np.sort(cogsplat.decode(tmp_path / "a.cogs").extras["object"]), np.sort(labels)
    )
