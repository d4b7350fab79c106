"""Check of all files that a command writes, against the files that it reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from cogsplat.formats.scenes.input_files import input_files
from cogsplat.formats.storage.atomic import check_output, exists
from cogsplat.formats.storage.regular_files import FileKind, check_auxiliary, file_identities
from cogsplat.tools.terminal.standard_streams import given_inputs


def check_outputs(
    *outputs: Path | None,
    force: bool,
    auxiliary: Mapping[Path, FileKind] | None = None,
    inputs: Sequence[Path] = (),
    others: Sequence[Path] = (),
) -> None:
    """Check every file that the running command writes, before the work that produces it.

    The inputs are the paths that the command line and ``--config`` give to arguments and options of
    types for inputs, with the files that they refer to.

    Parameters
    ----------
    outputs : Path or None
        Output files; None for an output that is not written.
    force : bool
        Whether existing outputs may be replaced.
    auxiliary : mapping of Path to FileKind, optional
        Kind of each auxiliary file, such as a checkpoint. `force` does not apply to them: a file of
        its kind is replaced or continued, any other file is refused.
    inputs : sequence of Path
        Further inputs, which no parameter names.
    others : sequence of Path
        Further outputs, which are checked later.

    Raises
    ------
    click.UsageError
        Two of the files are the same.
    StorageError
        See `check_output` and `check_auxiliary`.
    """
    written = [path for path in outputs if path is not None]
    auxiliary = auxiliary or {}
    check_distinct(*written, *auxiliary)
    read: list[Path] = []
    # A new output is no input: listing a folder of photos may take long.
    if auxiliary or any(map(exists, written)):
        read = [file for path in (*given_inputs(), *inputs) for file in input_files(path)]
    for path, kind in auxiliary.items():
        # Others may be hard links of each other, as programs make them of files with equal bytes.
        for other in others:
            check_distinct(other, path)
        check_auxiliary(path, kind, inputs=read)
    for path in written:
        check_output(path, force=force, inputs=read)


def check_distinct(*paths: Path) -> None:
    """Refuse a list of outputs in which two paths name the same file.

    Raises
    ------
    click.UsageError
        Two paths name one file.
    """
    seen: dict[object, Path] = {}
    for path in paths:
        for identity in file_identities(path):
            other = seen.setdefault(identity, path)
            if other is not path:
                raise click.UsageError(f"{path}: is the output {other} as well, expected two files")
