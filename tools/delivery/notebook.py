"""Scenes in Jupyter: the viewer of ``tools/web`` as a widget that reads from an open file."""

from __future__ import annotations

from importlib.resources import files
from pathlib import PurePath
from typing import Any, Final

from cogsplat.codec.errors import CogsplatError, MissingExtraError
from cogsplat.formats.cogs.reader import CogsFile

_PROGRAMS: Final = ("worker.js", "viewer_worker.js")
# The longest range that a reader asks for in one request is 4 MiB (SPEC 8.8).
_MOST_BYTES: Final = 16 << 20


def show(file: CogsFile) -> Any:
    """Return a widget that shows a scene and fetches it from the kernel by ranges.

    Parameters
    ----------
    file : CogsFile
        Stays open for as long as the widget is to read from it.

    Returns
    -------
    anywidget.AnyWidget

    Raises
    ------
    MissingExtraError
        anywidget is not installed.

    Examples
    --------
    >>> import cogsplat
    >>> from cogsplat.tools.delivery.notebook import answer
    >>> with cogsplat.open("scene.cogs") as file:
    ...     content, buffers = answer(file, {"type": "read", "id": 1, "offset": 0, "length": 4})
    >>> buffers[0][1:]
    b'COG'
    """
    try:
        import anywidget
    except ImportError as error:
        raise MissingExtraError(
            "needs-anywidget",
            "notebooks show scenes with anywidget (pip install 'cogsplat[notebook]')",
        ) from error

    widget: Any = anywidget.AnyWidget(_esm=_program("viewer.js"))

    def received(_widget: object, message: object, _buffers: object) -> None:
        content, buffers = answer(file, message)
        widget.send(content, buffers)

    widget.on_msg(received)
    return widget


def bundle(file: CogsFile) -> Any:
    """Return what a notebook shows of an open file; without the extra, its name and its size."""
    text = (
        f"{file.name}: {file.root.splats:,} splats, SH degree {file.root.sh_degree}, "
        f"{file.file_length:,} bytes"
    )
    try:
        shown = show(file)
    except MissingExtraError as error:
        return {"text/plain": f"{text}\n{error}"}
    made = shown._repr_mimebundle_()
    data, metadata = made if isinstance(made, tuple) else (made, {})
    return {**data, "text/plain": text}, metadata


def answer(file: CogsFile, message: object) -> tuple[dict[str, object], list[bytes]]:
    """Answer a message of the widget in the browser (``tools/web/src/viewer/notebook.ts``).

    Parameters
    ----------
    file : CogsFile
    message : object
        ``{"type": "open"}`` asks for the scene's name, its length and the programs of its workers,
        ``{"type": "read", "id", "offset", "length"}`` for bytes. Others are told that they are
        not understood: a page can send anything.

    Returns
    -------
    content : dict
        The answer, under the ``id`` that was asked with.
    buffers : list of bytes
        What is too long for it.
    """
    match message:
        case {"type": "open"}:
            return {
                "type": "scene",
                "name": PurePath(file.name).name,
                "length": file.source_bytes,
                "programs": [_program(name) for name in _PROGRAMS],
            }, []
        case {"type": "read", "id": int(key), "offset": int(offset), "length": int(length)}:
            if not (offset >= 0 and 0 <= length <= _MOST_BYTES):
                return {"type": "failed", "id": key, "message": f"{length} bytes asked for"}, []
            try:
                part = file.read_bytes(offset, length)
            except (CogsplatError, ValueError) as error:
                # A file that was closed meanwhile raises ValueError.
                return {"type": "failed", "id": key, "message": str(error)}, []
            return {"type": "bytes", "id": key}, [part]
        case _:
            return {"type": "failed", "id": -1, "message": "not understood"}, []


def _program(name: str) -> str:
    return files("cogsplat.tools").joinpath("web", "dist", name).read_text(encoding="utf-8")
