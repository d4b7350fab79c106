"""Verification: every check of a whole file, one by one, and all findings of a broken one."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from cogsplat.codec.errors import (
    CogsplatError,
    FormatError,
    LimitError,
    StorageError,
    TruncatedError,
)
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.storage.source import Source

from .drawn_chunks import first_level
from .folder_places import check_object, key_of
from .layout import SegmentKind

if TYPE_CHECKING:
    from cogsplat.formats.storage.limits import Limits

    from .reader import CogsFile

# A message that names its clause, where the error has no field for it.
_CLAUSE: Final = re.compile(r"\(SPEC (\d+(?:\.\d+)?)\)")


# What a source that has not arrived whole lacks: its end, or objects of a folder.
_NOT_THERE: Final = ("file-truncated", "segment-missing")


# Segments whose bytes are not those that were written.
_DAMAGED: Final = ("segment-crc", "segment-hash")


@dataclass(frozen=True)
class Check:
    """One check of an open file.

    Parameters
    ----------
    what : str
        What is checked, for people: ``chunk 3``.
    offset : int
        Byte offset of the segment that is checked.
    run : callable
        Raises a `CogsplatError` where the file breaks a rule.
    """

    what: str
    offset: int
    run: Callable[[], object]


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


def checks(file: CogsFile) -> Iterator[Check]:
    """Yield every check that a verifier makes of an open file (SPEC 1.4).

    Parameters
    ----------
    file : CogsFile
        Opened, so that preamble, root, pages and tables are checked already.

    Yields
    ------
    Check
        The decoded size, CRC and hash of every segment, of a folder the names of its objects, then
        codebooks, cameras, compensation, the view table, and of every chunk its head, its
        refinement, its tail with its attributes, and its box.
    """
    yield Check("decoded size", 0, file.require_size)
    for row in range(len(file.segments)):
        yield Check(f"segment {row}", int(file.offsets[row]), partial(read_verified, file, row))
    for name, row in file.objects().items():
        yield Check(name, int(file.offsets[row]), partial(_check_object, file, name))
    for book in range(len(file.root.codebooks)):
        # Codebooks that no chunk needs are part of the file too.
        kinds = (SegmentKind.SHAPE_CODEBOOK, SegmentKind.COLOUR_BAND1)
        rows = [row for kind in kinds for row in file.segment_rows(kind, book)]
        offset = int(file.offsets[rows[0]]) if rows else 0
        yield Check(f"codebook {book}", offset, partial(file.load_codebook, book))
    if file.camera_row is not None:
        yield Check("cameras", int(file.offsets[file.camera_row]), file.cameras)
    layers = np.flatnonzero(file.segments.kind == SegmentKind.COMPENSATION)
    if len(layers):
        yield Check("compensation", int(file.offsets[layers[0]]), file.compensation)
    if file.view_table_row is not None:
        yield Check("view table", int(file.offsets[file.view_table_row]), file.view_table)
    for chunk in range(file.num_chunks):
        yield from _chunk_checks(file, chunk)


def _chunk_checks(file: CogsFile, chunk: int) -> Iterator[Check]:
    """Yield the checks of one chunk, each with the segment that it adds to the one before."""
    rows = file.rows_of(chunk)
    start = int(file.offsets[rows.head])

    def coarse() -> None:
        means = file.decode([chunk], sh_degree=0, refine=False, extras=False, threads=1).means
        _require_inside(file, chunk, means, start)

    yield Check(f"head of chunk {chunk}", start, coarse)
    if rows.refinement is not None:
        at = int(file.offsets[rows.refinement])

        def fine() -> None:
            means = file.decode([chunk], sh_degree=0, extras=False, threads=1).means
            _require_inside(file, chunk, means, at)

        yield Check(f"refinement of chunk {chunk}", at, fine)
    first = first_level(file.root.levels, chunk)
    for later, opacities in enumerate(rows.opacities, start=1):
        yield Check(
            f"opacities of chunk {chunk} at level {first + later}",
            int(file.offsets[opacities]),
            partial(
                file.decode, [chunk], level=first + later, sh_degree=0, extras=False, threads=1
            ),
        )
    rest = [row for row in (rows.tail, rows.attributes) if row is not None]
    if rest:
        yield Check(
            f"tail and attributes of chunk {chunk}",
            int(file.offsets[rest[0]]),
            partial(file.decode, [chunk], threads=1),
        )


def read_verified(file: CogsFile, row: int) -> memoryview:
    """Return a segment's bytes, their CRC and their hash checked.

    Raises
    ------
    TruncatedError
        As `CogsFile.read_segment`.
    FormatError
        ``segment-crc``, ``segment-hash``, and as `CogsFile.read_segment`.
    """
    data = file.read_segment(row)
    if key_of(data) != file.segments.hash[row].tobytes():
        raise FormatError(
            "segment-hash",
            f"{file.name}: segment {row}: its SHA-256 does not match the table's",
            clause="5.3",
            offset=int(file.offsets[row]),
        )
    return data


def _check_object(file: CogsFile, name: str) -> None:
    check_object(name, file.read_object(name), file.name)


def _require_inside(file: CogsFile, chunk: int, means: np.ndarray, offset: int) -> None:
    box = file.chunks.box[chunk]
    if not ((means >= box[:3]) & (means <= box[3:])).all():
        raise FormatError(
            "chunk-box",
            f"{file.name}: chunk {chunk}: means from {means.min(axis=0).tolist()} to "
            f"{means.max(axis=0).tolist()}, expected within {box.tolist()}",
            clause="5.4",
            offset=offset,
        )


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
    from .reader import open_cogs

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
