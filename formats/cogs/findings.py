"""Report all broken rules of a file (``cogsplat check``)."""

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

# Clause in the message of an error without a `clause` field.
_CLAUSE: Final = re.compile(r"\(SPEC (\d+(?:\.\d+)?)\)")


# Codes of a source that is still being received: a missing end, or missing objects of a folder.
_INCOMPLETE: Final = ("file-truncated", "segment-missing")

# Codes of a segment whose bytes changed since it was written.
_DAMAGED: Final = ("segment-crc", "segment-hash")


@dataclass(frozen=True)
class Finding:
    """One broken rule of a file.

    Parameters
    ----------
    code : str
        Reason code (SPEC 12).
    kind : str
        Class of the code in SPEC 12: ``format``, ``truncated``, ``unsupported`` or ``limit``.
    clause : str
        Broken clause of SPEC.
    offset : int or None
        Byte offset of the error, if known.
    message : str
        Fault, its place, and the expected value.
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
    """Check a file and return its broken rules, in the order of the checks.

    Parameters
    ----------
    source : Source
        Source of the file.
    partial : bool
        Whether to accept a file that is still being received.
    limits : Limits, optional
        Memory and size limits.
    progress : Progress
        Callback, called with ``("validate", checks done, checks)``.

    Returns
    -------
    list of Finding
        Broken rules; empty for a conforming file. A broken preamble, root or table is the only
        finding, because the rest of the file depends on it. A short file gives ``file-truncated``
        and the findings of its received part. A long file gives ``file-trailing`` and the findings
        of the part up to its stated end.

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
        # The offset of a truncation is the end of the source.
        short = isinstance(error, TruncatedError) and error.code != "segment-missing"
        first = finding_of(error, source.size if short else None)
        if error.code not in (*_INCOMPLETE, "file-trailing"):
            return [first]
        if error.code == "file-trailing" or not partial:
            found.append(first)
        # A file that is too long is checked up to its stated end.
        end = first.offset if error.code == "file-trailing" else None
        try:
            file = open_cogs(source, partial=True, size_bytes=end, limits=limits)
        except CogsplatError as second:
            return [*found, finding_of(second)]
    # Opening reports missing segments of a local folder; on a network, reading reports each one.
    reported = partial or any(finding.code == "segment-missing" for finding in found)
    skipped = _INCOMPLETE if reported else _INCOMPLETE[:1]
    steps = list(checks(file))
    for done, check in enumerate(steps, start=1):
        try:
            check.run()
        except CogsplatError as error:
            finding = finding_of(error, check.offset)
            # A missing or damaged segment fails again wherever it is used: report it once.
            is_repeated = finding.code in skipped
            if finding.code == "object-hash":
                # A damaged segment also changes the hash of its object.
                is_repeated = any(other.code in _DAMAGED for other in found)
            if not is_repeated and all(
                (finding.code, finding.offset) != (other.code, other.offset) for other in found
            ):
                found.append(finding)
        progress("validate", done, len(steps))
    return found


def finding_of(error: CogsplatError, offset: int | None = None) -> Finding:
    """Convert an error into a finding.

    Parameters
    ----------
    error : CogsplatError
        Error of a check.
    offset : int or None
        Byte offset of the error, for errors without one.

    Raises
    ------
    StorageError
        `error` itself, if it is about storage and not about the file.
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
    """Return the class of an error in SPEC 12."""
    if isinstance(error, TruncatedError):
        return "truncated"
    if isinstance(error, FormatError):
        return "format"
    return "limit" if isinstance(error, LimitError) else "unsupported"
