"""All broken rules of a file, each as a finding."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from cogsplat.codec.errors import (
    CogsplatError,
    FormatError,
    LimitError,
    StorageError,
    TruncatedError,
)
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import Source

from .reader import open_cogs
from .verification import checks

# A message that names its clause, where the error has no field for it.
_CLAUSE: Final = re.compile(r"\(SPEC (\d+(?:\.\d+)?)\)")


# What a source that has not arrived whole lacks: its end, or objects of a folder.
_NOT_THERE: Final = ("file-truncated", "segment-missing")


# Segments whose bytes are not those that were written.
_DAMAGED: Final = ("segment-crc", "segment-hash")


@dataclass(frozen=True)
class Finding:
    """One broken rule.

    Parameters
    ----------
    code : str
        Reason code (SPEC 12).
    kind : str
        ``format``, ``truncated``, ``unsupported`` or ``limit``, as SPEC 12 classes the code.
    clause : str
        SPEC clause that the file breaks.
    offset : int or None
        Byte offset of what breaks it, where known.
    message : str
        What was found, where, and what was expected.
    """

    code: str
    kind: str
    clause: str
    offset: int | None
    message: str


def findings(
    source: Source,
    *,
    partial: bool = False,
    limits: Limits | None = None,
    progress: Progress = silent,
) -> list[Finding]:
    """Return every broken rule of a file, none where it conforms.

    Parameters
    ----------
    source : Source
    partial : bool
        Whether a file that is still being received is no finding.
    limits : Limits, optional
        What may be allocated for it.
    progress : Progress
        Called with ``("validate", checks done, checks)``.

    Returns
    -------
    list of Finding
        In the order in which the checks find them. A file whose preamble, root or tables break a
        rule gives the first such rule alone, because nothing behind them has a meaning then. A file
        that is short gives ``file-truncated`` and what is wrong with the part that is there, one
        that is long ``file-trailing`` and what is wrong with the part before that.

    Raises
    ------
    StorageError
        The source cannot be read.

    Examples
    --------
    >>> from cogsplat.formats.storage.source import BytesSource
    >>> [finding.code for finding in findings(BytesSource(b"ply"))]
    ['not-cogs']
    """
    found: list[Finding] = []
    try:
        file = open_cogs(source, limits=limits)
    except CogsplatError as error:
        # What is short breaks its rule where it ends.
        short = isinstance(error, TruncatedError) and error.code != "segment-missing"
        first = finding_of(error, source.size if short else None)
        if error.code not in (*_NOT_THERE, "file-trailing"):
            return [first]
        if error.code == "file-trailing" or not partial:
            found.append(first)
        # A file that is long is checked up to where it should end.
        end = first.offset if error.code == "file-trailing" else None
        try:
            file = open_cogs(source, partial=True, size_bytes=end, limits=limits)
        except CogsplatError as second:
            return [*found, finding_of(second)]
    # What a local folder lacks was counted when it was opened; over a network each is met here.
    counted = partial or any(finding.code == "segment-missing" for finding in found)
    passed_over = _NOT_THERE if counted else _NOT_THERE[:1]
    steps = list(checks(file))
    for done, check in enumerate(steps, start=1):
        try:
            check.run()
        except CogsplatError as error:
            finding = finding_of(error, check.offset)
            # A broken segment fails again wherever it is used, and so does what is not there.
            follows = finding.code in passed_over
            if finding.code == "object-hash":
                # The object of a damaged segment has another hash because of it.
                follows = any(other.code in _DAMAGED for other in found)
            if not follows and all(
                (finding.code, finding.offset) != (other.code, other.offset) for other in found
            ):
                found.append(finding)
        progress("validate", done, len(steps))
    return found


def finding_of(error: CogsplatError, offset: int | None = None) -> Finding:
    """Return a refusal as a finding; `offset` is where the file breaks the rule, if that is known.

    Raises
    ------
    StorageError
        `error` itself where it says nothing about the file.
    """
    if isinstance(error, StorageError):
        raise error
    stated = _CLAUSE.search(error.message)
    clause = error.clause if isinstance(error, FormatError) else ""
    known = error.offset if isinstance(error, FormatError) else None
    return Finding(
        code=error.code,
        kind=_kind(error),
        clause=clause or (stated[1] if stated else ""),
        offset=offset if known is None else known,
        message=error.message,
    )


def _kind(error: CogsplatError) -> str:
    if isinstance(error, TruncatedError):
        return "truncated"
    if isinstance(error, FormatError):
        return "format"
    return "limit" if isinstance(error, LimitError) else "unsupported"
