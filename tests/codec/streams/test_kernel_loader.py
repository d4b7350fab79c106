"""Kernels loaded behind the work: in use once they are there, in nobody's way before."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from cogsplat.codec import compiling
from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.streams import kernel_loader
from cogsplat.codec.streams.kernel_loader import KernelLoader

VECTORS = Path(__file__).resolve().parents[2] / "vectors" / "valid"

SOURCE = """
from cogsplat.codec.compiling import called_with, jit_kernel

@called_with("int64")
@jit_kernel
def first(x):
    return x + 1

@called_with("int64")
@jit_kernel
def second(x):
    return x + 2
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Return the name of a module with two uncompiled kernels."""
    name = f"two_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    # Handlers of exit and fork would outlive the test.
    monkeypatch.setattr(KernelLoader, "_register", lambda self: None)
    yield name
    for kernel in ("first", "second"):
        compiling._DECLARED.pop(f"{name}:{kernel}", None)
    sys.modules.pop(name, None)


def signatures(module):
    return [len(k.function.signatures) for k in compiling.kernels_in([module])]


def test_all_kernels_are_loaded_once(module):
    calls = []
    before = sys.getswitchinterval()
    loader = KernelLoader([module], lambda: calls.append(threading.current_thread().daemon))
    loader.join()
    loader.start()
    loader.start()
    loader.join()
    assert calls == [True]
    assert signatures(module) == [1, 1]
    assert sys.getswitchinterval() == before


def test_loading_stops_when_the_process_exits(module, monkeypatch):
    calls = []
    loader = KernelLoader([module], lambda: calls.append(1))
    plain = compiling.DeclaredKernel.compile

    def compile_and_stop(kernel):
        plain(kernel)
        loader._stopped.set()

    monkeypatch.setattr(compiling.DeclaredKernel, "compile", compile_and_stop)
    loader.start()
    loader.join()
    assert calls == []
    assert signatures(module) == [1, 0]


def test_exit_waits_for_the_current_kernel(module, monkeypatch):
    under_way, go_on, done = threading.Event(), threading.Event(), []

    def compile_slowly(kernel):
        under_way.set()
        assert go_on.wait(60)
        done.append(kernel.name)

    monkeypatch.setattr(compiling.DeclaredKernel, "compile", compile_slowly)
    loader = KernelLoader([module], lambda: done.append("finished"))
    loader.start()
    assert under_way.wait(60)
    threading.Timer(0.05, go_on.set).start()
    loader._stop()
    assert done == [f"{module}:first"]
    loader.join()
    assert done == [f"{module}:first"]


def test_a_failed_load_warns(module, monkeypatch):
    calls, found = [], []

    def refuse(kernel):
        raise RuntimeError("no such processor")

    monkeypatch.setattr(compiling.DeclaredKernel, "compile", refuse)
    monkeypatch.setattr(kernel_loader.warnings, "warn", lambda what, **_: found.append(what))
    loader = KernelLoader([module], lambda: calls.append(1))
    loader.start()
    loader.join()
    assert calls == []
    assert [type(what) for what in found] == [CogsplatWarning]
    assert "no such processor" in str(found[0])


def test_without_numba_there_is_no_thread(module, monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    loader = KernelLoader([module], lambda: None)
    loader.start()
    assert loader._thread is None


SETUP = """
import sys, cogsplat
from pathlib import Path
from cogsplat.codec.streams import decoding_tiers
vectors = sorted(Path(sys.argv[1]).glob("*.cogs"))
assert "numba" not in sys.modules
decoding_tiers.MIN_SPLATS_REPEATED = 1
plain = [cogsplat.decode(vectors[0]), cogsplat.decode(vectors[0])]
"""

USED = """
decoding_tiers.LOADER.join()
from cogsplat.codec.compiling import kernels_in
kernels = kernels_in(decoding_tiers.KERNEL_MODULES)
assert decoding_tiers.is_compiled()
assert (cogsplat.decode(vectors[0]).quats == plain[0].quats).all()
# Decoding calls the loaded code: nothing is compiled in the middle of a decode.
assert len(kernels) == 2
assert {len(kernel.function.signatures) for kernel in kernels} == {1}
for vector in vectors:
    cogsplat.decode(vector)
assert {len(kernel.function.signatures) for kernel in kernels} == {1}
"""

DECIDED = """
decoding_tiers.use_compiled(False)
decoding_tiers.LOADER.join()
cogsplat.decode(vectors[0])
assert not decoding_tiers.is_compiled()
"""

FORKED = """
import os, warnings
warnings.simplefilter("ignore", DeprecationWarning)
child = os.fork()
if child == 0:
    assert sys.getswitchinterval() == 0.005
    cogsplat.decode(vectors[0])
    decoding_tiers.LOADER.join()
    assert decoding_tiers.is_compiled()
    os._exit(7)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
"""


@pytest.mark.parametrize(
    "script",
    [
        USED,
        DECIDED,
        "",
        pytest.param(
            FORKED, marks=pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
        ),
    ],
    ids=["used", "decided", "ends at once", "forked"],
)
def test_a_process_that_decodes_again(script):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SETUP + script, str(VECTORS)],
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert (done.returncode, done.stderr) == (0, "")
