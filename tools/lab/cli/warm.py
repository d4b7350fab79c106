"""``cogsplat lab warm``: compile every kernel before the first command that needs it."""

from __future__ import annotations

from typing import Final

import click

from cogsplat.codec.compiling import DeclaredKernel, kernels_in
from cogsplat.codec.errors import StorageError
from cogsplat.codec.streams.decoding_tiers import KERNEL_MODULES
from cogsplat.codec.threads import thread_count
from cogsplat.tools.terminal.options import json_option, quiet_option, threads_option
from cogsplat.tools.terminal.output import count_text, print_facts, print_json, print_line
from cogsplat.tools.terminal.progress_bars import Stages
from cogsplat.tools.workflow.compile_ahead import CompileAhead

# Modules with the kernels of training.
_TRAINING: Final = tuple(
    f"cogsplat.codec.fit.{name}"
    for name in ("tile_kernels", "splat_kernels", "splat_adam", "image_losses")
)


def every_kernel() -> list[DeclaredKernel]:
    """Return the kernels of encoding, with and without given cameras, decoding and training."""
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.needed_kernels import needed_kernels

    encoding = needed_kernels(EncodeConfig())
    return encoding + kernels_in((*KERNEL_MODULES, *_TRAINING))


@click.command(epilog="\b\nExample:\n  cogsplat lab warm")
@threads_option
@quiet_option
@json_option
def warm(threads: int, quiet: bool, as_json: bool) -> None:
    """Compile the kernels of all commands.

    Otherwise, each command compiles the kernels it needs at its first run. The machine code is kept
    in the folder NUMBA_CACHE_DIR, else in the installed package or the user's cache folder.
    """
    with Stages(shown=not (quiet or as_json)) as stages:
        kernels = every_kernel()
        folders = sorted({str(kernel.folder) for kernel in kernels if kernel.folder is not None})
        if not folders:
            raise StorageError(
                "no-kernel-folder",
                "no folder for compiled kernels can be written, in the package or in the user's "
                "cache, expected NUMBA_CACHE_DIR to name one",
            )
        stages("import", 1, 1)
        with CompileAhead(kernels, thread_count(threads)) as ahead:
            ahead.finish(stages)
    if as_json:
        print_json(
            {
                "kernels": len(kernels),
                "kernels_compiled": ahead.total,
                "kernel_folders": folders,
                "seconds": stages.rounded_seconds(),
            }
        )
    elif not quiet:
        there = len(kernels) - ahead.total
        print_line(f"{count_text(ahead.total, 'kernel')} compiled, {there} were there already")
        print_facts(("folders", ", ".join(folders)), ("time", stages.summary()))
