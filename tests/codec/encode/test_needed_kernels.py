"""Kernels that an encode compiles ahead: exactly the kernels it calls, with declared types."""

import subprocess
import sys
from pathlib import Path

import pytest

from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.needed_kernels import needed_kernels

ROOT = Path(__file__).resolve().parents[3]

# Encodes a scene with cameras, without, and by the profile vq; decodes it, and compares the types
# of every call.
CALLS = """
import sys
from numba.core import sigutils
import cogsplat
from cogsplat.codec.compiling import kernels_in
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.needed_kernels import needed_kernels
from cogsplat.codec.render import splat_blocks
from cogsplat.codec.streams import decoding_tiers
from cogsplat.codec.streams.decoding_tiers import KERNEL_MODULES
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

# Otherwise numpy decodes until the kernels are loaded in the background.
decoding_tiers.use_compiled(True)
# As if the scene were large.
splat_blocks.MIN_BLOCKED_SPLATS = 0
config = EncodeConfig(chunk_splats=300, threads=1)
for cameras in (synth_cameras(4, 64, 48), None):
    splats = synth(3000)
    cogsplat.encode(splats, sys.argv[1], cameras=cameras, config=config, force=True)
cogsplat.decode(sys.argv[1])
cogsplat.encode(splats, sys.argv[1], cameras=synth_cameras(4, 64, 48), preset="fast", force=True)
vq = EncodeConfig(chunk_splats=300, threads=1, profile="vq", order="contribution")
cogsplat.encode(splats, sys.argv[1], cameras=synth_cameras(4, 64, 48), config=vq, force=True)
cogsplat.decode(sys.argv[1])
kernels = needed_kernels(config) + kernels_in(KERNEL_MODULES)
for kernel in kernels:
    types, _ = sigutils.normalize_signature(f"({kernel.types},)")
    called = kernel.function.signatures
    assert called == [types], f"{kernel.name}: called with {called}, declared {types}"
"""


@pytest.mark.slow
def test_every_kernel_is_called_with_the_types_that_are_declared(tmp_path):
    command = [sys.executable, "-c", CALLS, str(tmp_path / "a.cogs")]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr


def test_what_an_encode_does_not_call_is_not_needed():
    def modules(**config):
        kernels = needed_kernels(EncodeConfig(**config))
        return {kernel.function.__module__.split(".")[-1] for kernel in kernels}

    whole = modules()
    assert {"marginal_gains", "gradients", "shift_kernels", "sensitivities"} <= whole
    fast = modules(order="contribution", compensate=False)
    assert whole - fast == {"marginal_gains", "gradients", "shift_kernels"}
    near_lossless = modules(order="contribution", profile="near-lossless")
    assert fast - near_lossless == {"sensitivities", "sparse_codes"}
    kernels = needed_kernels(EncodeConfig())
    assert len({kernel.name for kernel in kernels}) == len(kernels)
