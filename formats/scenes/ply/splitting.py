"""Split of a PLY into parts: its rows, copied unchanged into one PLY for each part of space.

Neither the scene nor the centres of its splats are held in memory. A sample decides on the regions;
passes over the rows count them by part and copy them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from io import BufferedReader
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import StorageError, TruncatedError, UnsupportedError
from cogsplat.codec.partition.nested_cells import WHOLE_SCENE, Region
from cogsplat.codec.partition.scene_parts import (
    count_parts,
    divide,
    halving_planes,
    part_regions,
    refined,
)
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.storage.atomic import StrPath, atomic_write, open_for_read, storage_errors

from .header import Element, check_size, match_fields, read_header, with_count

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Rows = NDArray[np.void]

# Centres of a sample at most, 24 bytes each, and rows of the runs in which it is read: a disk takes
# as long for one row as for a run of them.
_SAMPLE: Final = 1 << 20
_RUN_ROWS: Final = 64

# Least centres of a part that is cut again, so that a plane can halve it.
_LEAST_SAMPLE: Final = 16

# Ratio of a part's splats to the wanted number up to which the part is not cut again. With 64
# parts, a sample of 16,384 runs misjudges the splats of a part by some percent.
_TOLERANCE: Final = 1.25

# Bytes of a block of rows.
_BLOCK_BYTES: Final = 1 << 22

# Parts written in one pass over the rows. Systems allow a process 256 open files at least.
_OPEN_PARTS: Final = 128

_AXES: Final = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class PlyParts:
    """Parts that a PLY is split into.

    Parameters
    ----------
    regions : Region
        Tree of the regions between the parts.
    counts : tuple of int
        Splats of each part.
    samples : tuple of (n, 3) float64
        Centres of each part that are drawn evenly from it, scene units.
    has_sh : bool
        Whether splats have SH coefficients above degree 0.
    state : tuple of int
        Size, bytes, and time of the last change, ns, of the PLY.
    """

    regions: Region
    counts: tuple[int, ...]
    samples: tuple[F64, ...]
    has_sh: bool
    state: tuple[int, int]


def plan_parts(path: StrPath, most: int, *, progress: Progress = silent) -> PlyParts:
    """Find regions that cut a PLY into parts of about equal numbers of splats.

    Parameters
    ----------
    path : path
        PLY of a 3DGS scene: little-endian, without elements besides ``vertex``, centres in float32.
    most : int
        Splats of a part, at least 1. A part may have a quarter more, or any number of splats that
        no plane separates: coincident ones, and those with NaN in their centres, which belong to
        the first part.
    progress : Progress
        Called with ``("sample", rows, all rows)`` and ``("count", rows, all rows)``.

    Returns
    -------
    PlyParts
        The same for the same file, on any machine.

    Raises
    ------
    UnsupportedError
        ``ply-not-plain``: another layout; a conversion to PLY writes this one.
    CogsplatError
        The header is refused, see `read_ply`, or ``file-changed``.
    """
    with _opened(path) as rows:
        sample, regions = rows.first_sample(most, progress)
        while True:
            counts = rows.count(regions, progress)
            large = [n for n, count in enumerate(counts) if count > _TOLERANCE * most]
            if not large:
                break
            found = rows.samples(regions, {n: counts[n] for n in large}, progress)
            finer = {n: halving_planes(each, step, most) for n, (each, step) in found.items()}
            if all(region is WHOLE_SCENE for region in finer.values()):
                break
            regions = refined(regions, finer)
            sample = np.concatenate([sample, *(each for each, _ in found.values())])
        return PlyParts(
            regions,
            tuple(counts.tolist()),
            tuple(sample[places] for places in divide(regions, sample)),
            bool(match_fields(rows.vertex, rows.where)["shN"]),
            rows.state,
        )


def write_parts(
    path: StrPath,
    parts: PlyParts,
    outputs: Sequence[StrPath],
    *,
    force: bool = False,
    progress: Progress = silent,
) -> None:
    """Copy each row of a PLY to the PLY of its part.

    Parameters
    ----------
    path : path
        PLY that `plan_parts` read.
    parts : PlyParts
        Its parts.
    outputs : sequence of path
        Output of each part. It has the header of `path` with another count, and the bytes of the
        part's rows in their order.
    force : bool
        Whether existing files may be replaced.
    progress : Progress
        Called with ``("copy", rows, all rows)``.

    Raises
    ------
    StorageError
        ``file-changed``: the PLY is no longer the one that was planned for; others of
        `atomic_write`, e.g. ``exists``.
    CogsplatError
        See `plan_parts`.
    """
    with _opened(path, parts.state) as rows:
        passes = -(-len(outputs) // _OPEN_PARTS)
        for number in range(passes):
            group = slice(number * _OPEN_PARTS, (number + 1) * _OPEN_PARTS)
            with ExitStack() as stack:
                files = [
                    stack.enter_context(atomic_write(output, force)) for output in outputs[group]
                ]
                for file, count in zip(files, parts.counts[group], strict=True):
                    file.write(with_count(rows.head, count))
                for stop, block in rows.blocks():
                    divided = divide(parts.regions, _centres(block))[group]
                    plain = block.view(f"V{block.itemsize}")
                    for file, places in zip(files, divided, strict=True):
                        if len(places):
                            file.write(plain.take(places).data)
                    progress("copy", number * rows.total + stop, passes * rows.total)
                rows.require_unchanged()


@dataclass(eq=False)
class _PlainRows:
    """Rows of an open PLY whose only element is ``vertex``.

    `head` holds the bytes before the first row, `state` size and time of the last change.
    """

    file: BufferedReader
    where: str
    head: bytes
    vertex: Element
    state: tuple[int, int]

    @property
    def total(self) -> int:
        """Number of rows."""
        return self.vertex.count

    def blocks(
        self, starts: Iterable[int] | None = None, size: int = 0
    ) -> Iterator[tuple[int, Rows]]:
        """Yield blocks of rows, each with the number of the row behind it.

        The array of a block is used again for the next one. By default the blocks are all rows.
        """
        row = np.dtype([(prop.name, f"<{prop.dtype}") for prop in self.vertex.properties])
        size = size or max(1, _BLOCK_BYTES // row.itemsize)
        buffer = np.empty(min(size, self.total), row)
        for start in range(0, self.total, size) if starts is None else starts:
            block = buffer[: min(size, self.total - start)]
            self.file.seek(len(self.head) + start * row.itemsize)
            if self.file.readinto(block.view(np.uint8).data) != block.nbytes:
                raise TruncatedError(
                    "ply-truncated",
                    f"{self.where}: ended in the {len(block)} rows from row {start} of "
                    f"{self.total}, expected the size that it had when it was opened",
                )
            yield start + len(block), block

    def first_sample(self, most: int, progress: Progress) -> tuple[F64, Region]:
        """Return a sample of finite centres, read in runs, and the regions that it makes."""
        step = max(_RUN_ROWS, -(-self.total * _RUN_ROWS // _SAMPLE))
        found, read = [np.zeros((0, 3))], 0
        for stop, block in self.blocks(range(0, self.total, step), _RUN_ROWS):
            found.append(_finite(_centres(block)))
            read += len(block)
            progress("sample", stop, self.total)
        sample = np.concatenate(found)
        return sample, part_regions(sample, self.total / max(read, 1), most)

    def count(self, regions: Region, progress: Progress) -> I64:
        """Return the number of rows in each part."""
        counts = np.zeros(count_parts(regions), np.int64)
        for stop, block in self.blocks():
            counts += [len(places) for places in divide(regions, _centres(block))]
            progress("count", stop, self.total)
        return counts

    def samples(
        self, regions: Region, counts: dict[int, int], progress: Progress
    ) -> dict[int, tuple[F64, int]]:
        """Return finite centres of some parts, and the number of rows that each stands for."""
        steps = {
            n: max(1, min(-(-count * len(counts) // _SAMPLE), count // _LEAST_SAMPLE))
            for n, count in counts.items()
        }
        found: dict[int, list[F64]] = {n: [] for n in counts}
        passed = dict.fromkeys(counts, 0)
        for stop, block in self.blocks():
            centres = _centres(block)
            divided = divide(regions, centres)
            for n, step in steps.items():
                drawn = divided[n][-passed[n] % step :: step]
                found[n].append(_finite(centres[drawn]))
                passed[n] += len(divided[n])
            progress("sample", stop, self.total)
        return {n: (np.concatenate(each), steps[n]) for n, each in found.items()}

    def require_unchanged(self) -> None:
        """Refuse a file that another process has changed."""
        if _state(self.file) != self.state:
            raise StorageError(
                "file-changed",
                f"{self.where}: changed while being split, expected a file at rest",
            )


@contextmanager
def _opened(path: StrPath, state: tuple[int, int] | None = None) -> Iterator[_PlainRows]:
    """Open the rows of a PLY; refuse one of another layout, and one in another state."""
    where = os.fspath(path)
    with storage_errors(path), open_for_read(path) as file:
        header = read_header(file, where)
        vertex = header.vertex(where)
        is_plain = header.is_canonical and len(header.elements) == 1
        if not is_plain or any(p.dtype == "f8" for p in vertex.properties if p.name in _AXES):
            elements = ", ".join(element.name for element in header.elements)
            raise UnsupportedError(
                "ply-not-plain",
                f"{where}: {header.format} with the elements {elements}, expected "
                "binary_little_endian with vertex alone, and centres that are no doubles",
            )
        match_fields(vertex, where)
        found = _state(file)
        check_size(header, found[0], where)
        file.seek(0)
        head = file.read(header.data_offset)
        rows = _PlainRows(file, where, head, vertex, state or found)
        rows.require_unchanged()
        yield rows
        rows.require_unchanged()


def _state(file: BufferedReader) -> tuple[int, int]:
    """Return the size, bytes, and the time of the last change, ns, of an open file."""
    status = os.fstat(file.fileno())
    return status.st_size, status.st_mtime_ns


def _centres(block: Rows) -> F64:
    """Return the (n, 3) centres of rows; each column is contiguous."""
    columns = np.empty((3, len(block)))
    for axis, name in enumerate(_AXES):
        columns[axis] = block[name]
    return columns.T


def _finite(centres: F64) -> F64:
    """Return the centres without NaN and infinity."""
    return centres[np.isfinite(centres).all(axis=1)]
