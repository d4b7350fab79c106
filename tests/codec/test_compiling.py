"""Declared kernels: numba compiles the declared types and caches the code on disk."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cogsplat.codec import compiling

SOURCE = """
from cogsplat.codec.compiling import called_with, jit_kernel

@called_with("int64, float32[::1]")
@jit_kernel
def scaled(factor, values):
    return factor * values.sum()
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Return the name of a module that declares one kernel, in a folder of its own."""
    name = f"kernels_of_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    # Beside the module, whatever folder the tests' own kernels are kept in.
    from numba.core import config

    monkeypatch.setattr(config, "CACHE_DIR", "")
    yield name
    compiling._DECLARED.pop(f"{name}:scaled", None)
    sys.modules.pop(name, None)


def test_a_kernel_is_compiled_with_its_types_and_cached(module):
    (kernel,) = compiling.kernels_in([module])
    assert kernel.name == f"{module}:scaled"
    assert compiling.kernel_by_name(kernel.name) is kernel
    assert not kernel.is_cached()
    kernel.compile()
    assert kernel.is_cached()
    assert list(kernel.folder.glob("*.nbc"))
    before = len(kernel.function.signatures)
    assert kernel.function(2, np.ones(3, np.float32)) == 6.0
    # The call used the compiled code.
    assert len(kernel.function.signatures) == before == 1


def test_a_call_in_another_process_finds_what_was_kept(module):
    (kernel,) = compiling.kernels_in([module])
    kernel.compile()
    code = (
        f"import numpy, {module} as m\nassert m.scaled(2, numpy.ones(3, numpy.float32)) == 6\n"
        "stats = m.scaled.stats\nassert sum(stats.cache_hits.values()) == 1\n"
        "assert not stats.cache_misses"
    )
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr


def test_of_inner_kernels_nothing_is_kept(tmp_path, monkeypatch):
    from numba.core import config

    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    inner = compiling.jit_kernel(lambda x: x + 1, cached=False)
    assert inner(1) == 2
    assert not list(tmp_path.rglob("*.nb?"))


def test_a_name_that_is_not_declared_is_not_found(module):
    with pytest.raises(KeyError):
        compiling.kernel_by_name(f"{module}:other")


def test_kernels_run_where_no_folder_can_be_written(module, monkeypatch):
    from numba.core import caching

    def refuse(*args):
        raise RuntimeError("no locator available")

    monkeypatch.setattr(caching, "FunctionCache", refuse)
    monkeypatch.setattr("numba.core.dispatcher.FunctionCache", refuse)
    (kernel,) = compiling.kernels_in([module])
    assert kernel.folder is None
    assert not kernel.is_cached()
    kernel.compile()
    assert kernel.function(2, np.ones(3, np.float32)) == 6.0


def test_without_compilation_it_is_plain_python(module):
    code = (
        f"from cogsplat.codec.compiling import kernels_in\n(k,) = kernels_in([{module!r}])\n"
        "k.compile()\nassert k.folder is None\n"
        "assert k.function(2, __import__('numpy').ones(3)) == 6"
    )
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr


def test_the_core_imports_it_without_numba():
    code = "import sys\nimport cogsplat.codec.compiling\nassert 'numba' not in sys.modules"
    root = Path(__file__).resolve().parents[2]
    subprocess.run([sys.executable, "-c", code], cwd=root, check=True)


COLORAMA = """
__version__ = "0.4.6"
class Fore:
    BLUE = GREEN = MAGENTA = RED = WHITE = YELLOW = CYAN = BLACK = RESET = ""
class Style:
    BRIGHT = DIM = NORMAL = RESET_ALL = ""
def init(*arguments, **options):
    raise SystemExit("colorama swaps sys.stdout")
reinit = deinit = init
"""

FAILS_TO_COMPILE = """
from cogsplat.codec.compiling import jit_kernel
def add(a, b):
    return a + b
add = jit_kernel(add, cached=False)
from numba.core.errors import TypingError
try:
    add(1, "text")
except TypingError:
    print("refused")
"""


def test_compiling_leaves_standard_output_alone(tmp_path):
    (tmp_path / "colorama.py").write_text(COLORAMA)
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", FAILS_TO_COMPILE],
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("refused\n", "")
