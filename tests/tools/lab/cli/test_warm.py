"""Kernels compiled ahead, in this process and in workers; none is lost if a worker dies."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from running import Run

from cogsplat.codec import compiling
from cogsplat.codec.compiling import DeclaredKernel
from cogsplat.codec.errors import Cancelled
from cogsplat.tools.lab.cli import warm
from cogsplat.tools.workflow import compile_ahead
from cogsplat.tools.workflow.compile_ahead import CompileAhead

KERNEL = """
@called_with("int64")
@jit_kernel
def kernel{0}(x):
    return x + {0}
"""


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[DeclaredKernel]]:
    """Eight small kernels that are not compiled yet."""
    name = f"eight_{tmp_path.name}"
    source = "from cogsplat.codec.compiling import called_with, jit_kernel\n"
    (tmp_path / f"{name}.py").write_text(source + "".join(KERNEL.format(i) for i in range(8)))
    monkeypatch.syspath_prepend(tmp_path)
    # Workers import the module, and cache compiled kernels in its folder.
    monkeypatch.setenv("PYTHONPATH", ":".join(sys.path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    from numba.core import config

    monkeypatch.setattr(config, "CACHE_DIR", "")
    yield compiling.kernels_in([name])
    for number in range(8):
        compiling._DECLARED.pop(f"{name}:kernel{number}", None)
    sys.modules.pop(name, None)


@pytest.mark.parametrize("processes", [1, 3])
def test_all_are_compiled_and_kept(kernels: list[DeclaredKernel], processes: int) -> None:
    told: list[tuple[str, int, int]] = []
    with CompileAhead(kernels, processes) as ahead:
        assert ahead.total == 8
        ahead.finish(lambda *call: told.append(call))
    assert all(kernel.is_cached() for kernel in kernels)
    assert told[0][0] == "compile"
    assert told[-1] == ("compile", 8, 8)
    assert CompileAhead(kernels, processes).total == 0


def test_other_processes_take_their_share(
    kernels: list[DeclaredKernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Workers compile every kernel while this process compiles none."""
    with CompileAhead(kernels, 3) as ahead:
        for feeder in ahead._feeders:
            feeder.join()
    assert all(kernel.is_cached() for kernel in kernels)
    assert not any(kernel.function.signatures for kernel in kernels)  # type: ignore[attr-defined]


def test_a_kernel_that_another_command_compiles_meanwhile_is_skipped(
    kernels: list[DeclaredKernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = []
    with CompileAhead(kernels, 1) as ahead:
        for kernel in kernels[:5]:
            kernel.compile()
        monkeypatch.setattr(DeclaredKernel, "compile", lambda kernel: compiled.append(kernel))
        ahead.finish()
    assert len(compiled) == 3


def test_this_process_compiles_what_others_fail_to(
    kernels: list[DeclaredKernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compile_ahead, "_PROCESS", "cogsplat.no_such_module")
    with CompileAhead(kernels, 3) as ahead:
        ahead.finish()
    assert all(kernel.is_cached() for kernel in kernels)


def test_this_process_compiles_all_where_none_can_be_started(
    kernels: list[DeclaredKernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object, **options: object) -> None:
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    with CompileAhead(kernels, 3) as ahead:
        ahead.finish()
    assert all(kernel.is_cached() for kernel in kernels)


def test_cancelling_ends_the_other_processes(kernels: list[DeclaredKernel]) -> None:
    def stop(stage: str, done: int, total: int) -> None:
        raise Cancelled

    with pytest.raises(Cancelled), CompileAhead(kernels, 3) as ahead:
        ahead.finish(stop)
    assert all(process.poll() is not None for process in ahead._processes)


def test_warm_says_what_it_compiled(
    run: Run, kernels: list[DeclaredKernel], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(warm, "every_kernel", lambda: kernels)
    first, second = run("lab", "warm", "--json"), run("lab", "warm", "--json")
    assert first.json["kernels"] == first.json["kernels_compiled"] == 8
    assert first.json["kernel_folders"] == [str(tmp_path / "__pycache__")]
    assert second.json["kernels_compiled"] == 0
    assert "0 kernels compiled, 8 were there already" in run("lab", "warm").out
    assert run("lab", "warm", "--quiet").out == ""


def test_warm_says_that_no_folder_can_be_written(
    run: Run, kernels: list[DeclaredKernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DeclaredKernel, "folder", None)
    monkeypatch.setattr(warm, "every_kernel", lambda: kernels)
    told = run("lab", "warm")
    assert told.code == 4
    assert "[no-kernel-folder]" in told.err
    assert "NUMBA_CACHE_DIR" in told.err
