"""Change the description of a file or folder without encoding it: `cogsplat.describe`."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.views.view_text import unit_up
from cogsplat.formats.storage.atomic import StrPath, atomic_write, check_output, is_folder
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.pieced_source import Piece, whole_piece
from cogsplat.formats.storage.source import Source

from . import canonical_msgpack, layout
from .canonical_msgpack import Value
from .description import Description, Picture
from .description_segment import description_map, pack_segments, parse_description
from .folder_map import MANIFEST_NAME, MANIFEST_SUFFIX
from .folder_source import names_folder
from .folder_writer import copy_cogs, unpack_cogs
from .index_tables import SegmentTable
from .layout import SegmentKind
from .open_file import open_source
from .packing import folder_files
from .reader import CogsFile, open_cogs
from .root import parse_root, root_map
from .writer import laid_out_source, lay_out_index, plan_of_file, segment_table

_DESCRIPTION_KEYS: Final = frozenset(field.name for field in fields(Description))


@dataclass(frozen=True)
class Described:
    """Result of `describe`.

    Parameters
    ----------
    path : Path
        Written file or manifest.
    size_bytes : int
        Length of the file, or of the file that the folder stands for, bytes.
    written_bytes : int
        Bytes written: of the file; or of the manifest and the new objects of a folder.
    description : Description or None
        New description of the scene; None if it was removed.
    """

    path: Path
    size_bytes: int
    written_bytes: int
    description: Description | None


def describe(
    path: StrPath,
    description: Description | None,
    output: StrPath | None = None,
    *,
    up: str | ArrayLike | None = None,
    view: str | Camera | None = None,
    force: bool = False,
    limits: Limits | None = None,
) -> Described:
    """Store another description in a COGS file or folder, without encoding it again.

    All other segments keep their bytes, and root and description the keys that this version does
    not know; unknown keys inside their maps are left out with a warning. A folder gets a new
    manifest, which holds the description, and an object for each new picture.

    Parameters
    ----------
    path : path
        File, folder or manifest.
    description : Description or None
        New description; None removes it. A picture without its file stays the one that the scene
        has.
    output : path, optional
        New file; or, where it ends in ``.cogsm`` or is a folder, a manifest. By default `path`
        itself is replaced, which needs `force`.
    up : str or array-like of 3 float, optional
        New direction against gravity in the frame of the means, or its text (``"-y"``).
    view : Camera or str, optional
        New view where viewers start, or its text (``"x,y,z,tx,ty,tz,fov"``).
    force : bool
        Whether to replace an existing file or manifest.
    limits : Limits, optional
        Memory and size limits.

    Raises
    ------
    DataError
        ``bad-description``: a value that readers refuse, or a picture without its file;
        ``bad-view-text``, ``root-size``, ``bad-scene-info``.
    CogsplatError
        The scene cannot be read or the output cannot be written.

    Examples
    --------
    >>> import cogsplat
    >>> done = cogsplat.describe("scene.cogs", cogsplat.Description(title="Garden"), "new.cogs")
    >>> with cogsplat.open("new.cogs") as file:
    ...     file.description().title
    'Garden'
    """
    scene = Path(path)
    to_folder = names_folder(scene) if output is None else _names_manifest(Path(output))
    target = _target(scene if output is None else Path(output), to_folder=to_folder)
    inputs = [] if output is None else list(folder_files(scene))
    if target.parent.exists() or not to_folder:
        check_output(target, force=force, inputs=inputs)
    with open_cogs(open_source(scene), limits=limits) as file:
        filled = _with_files(description, file)
        source = described_source(file, filled, up=up, view=view)
        with open_cogs(source, limits=limits) as changed:
            if to_folder:
                done = unpack_cogs(changed, target.parent, name=target.name, force=force)
                written = done.manifest_bytes + done.written_bytes
            else:
                with atomic_write(target, force=force) as out:
                    written = copy_cogs(changed, out)
                    # Windows replaces no file that is open.
                    file.close()
    return Described(target, source.size, written, filled)


def _names_manifest(output: Path) -> bool:
    """Whether an output path names a folder or a manifest."""
    return is_folder(output) or output.name.lower().endswith(MANIFEST_SUFFIX)


def _target(path: Path, *, to_folder: bool) -> Path:
    """Return the path to write: `path` itself, or for a folder the manifest in it."""
    is_manifest = path.name.lower().endswith(MANIFEST_SUFFIX)
    return path / MANIFEST_NAME if to_folder and not is_manifest else path


def _with_files(description: Description | None, file: CogsFile) -> Description | None:
    """Return a description whose pictures without bytes have the stored ones; None if empty."""
    if description is None or description.is_empty:
        return None
    lacking = [name for name, one in description.pictures().items() if one.data is None]
    if not lacking:
        return description
    before = file.description(pictures=True)
    known = {} if before is None else before.pictures()
    filled: dict[str, Picture] = {}
    for name in lacking:
        picture, old = description.pictures()[name], known.get(name)
        if old is None or (picture.media_type, picture.width, picture.height) != (
            old.media_type,
            old.width,
            old.height,
        ):
            raise DataError("bad-description", f"{name}: no file, expected the picture's bytes")
        filled[name] = replace(picture, data=old.data)
    return description.with_pictures(filled)


def described_source(
    file: CogsFile,
    description: Description | None,
    *,
    up: str | ArrayLike | None = None,
    view: str | Camera | None = None,
) -> Source:
    """Return a source of the bytes that a file would have with a new description.

    Parameters
    ----------
    file : CogsFile
        Open file. Its segments are read from it on demand; keep it open as long as the source.
    description : Description or None
        New description, with the files of its pictures; None removes the description.
    up, view
        As in `describe`.

    Raises
    ------
    DataError
        ``bad-description``, ``bad-view-text``, ``root-size``, ``bad-scene-info``.
    """
    kinds = file.segments.kind
    kept = np.flatnonzero((kinds != SegmentKind.DESCRIPTION) & (kinds != SegmentKind.PICTURE))
    new = pack_segments(description, _unknown_keys(file))
    root = replace(
        file.root,
        chunks=file.chunks,
        up=file.root.up if up is None else unit_up(up),
        first_view=file.first_view(view=view, up=up),
    )
    added = segment_table(new)
    plan = plan_of_file(file.indices, kept, added.kind)
    table = SegmentTable.concatenate([file.segments.take(kept), added])

    def piece_of(row: int) -> Piece:
        if row >= len(kept):
            return whole_piece(new[row - len(kept)].payload)
        old = int(kept[row])
        return Piece(file.source, int(file.offsets[old]), int(file.segments.length[old]))

    return laid_out_source(file.name, lay_out_index(root, table, plan), piece_of)


def _unknown_keys(file: CogsFile) -> dict[str, Value]:
    """Return the keys of a file's description that this version does not know.

    Warn about unknown keys inside the maps of root and description, which are left out.
    """
    root_end = layout.PREAMBLE_BYTES
    root_end += layout.unpack_preamble(file.read_bytes(0, root_end), file.name).root_length
    data = file.read_bytes(0, root_end)[layout.PREAMBLE_BYTES :]
    stored = canonical_msgpack.unpack(data, file.name)
    lost = list(_lost_keys(stored, root_map(parse_root(stored, file.name)), "root"))
    unknown: dict[str, Value] = {}
    if file.description_row is not None:
        payload = bytes(file.read_segment(file.description_row))
        value = canonical_msgpack.unpack(payload, file.name, max_values=layout.MAX_CAMERA_VALUES)
        known = description_map(parse_description(value, file.name))
        assert isinstance(value, dict)
        unknown = {key: each for key, each in value.items() if key not in _DESCRIPTION_KEYS}
        lost += _lost_keys(value, {**known, **unknown}, "description")
    if lost:
        warnings.warn(
            f"{file.name}: keys that this version does not know are left out: {', '.join(lost)}",
            CogsplatWarning,
            stacklevel=4,
        )
    return unknown


def _lost_keys(stored: Value, kept: Value, where: str) -> Iterator[str]:
    """Yield the paths of keys of a value that another value lacks."""
    if isinstance(stored, dict) and isinstance(kept, dict):
        for key, value in stored.items():
            if key in kept:
                yield from _lost_keys(value, kept[key], f"{where}.{key}")
            elif value and (not isinstance(value, bytes) or any(value)):
                # Empty arrays and columns of zeros mean the same as none.
                yield f"{where}.{key}"
    elif isinstance(stored, list) and isinstance(kept, list):
        for number, (value, other) in enumerate(zip(stored, kept, strict=False)):
            yield from _lost_keys(value, other, f"{where}[{number}]")
