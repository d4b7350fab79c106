"""Jupyter widget with the viewer of ``tools/web``, which reads from an open file."""

from __future__ import annotations

from importlib.resources import files
from pathlib import PurePath
from typing import Any, Final

from cogsplat.codec.errors import CogsplatError, MissingExtraError
from cogsplat.formats.cogs.reader import CogsFile

_FURTHER_SCRIPTS: Final = ("worker.js", "viewer_worker.js", "viewer_extras.js")
# Limit on one read, bytes; the viewer requests at most 4 MiB at a time (SPEC 8.8).
_MAX_READ_BYTES: Final = 16 << 20


def show(file: CogsFile) -> Any:
    """Return a widget that shows a scene and fetches byte ranges from the kernel.

    Parameters
    ----------
    file : CogsFile
        Open file of the scene; it must stay open while the widget is in use.

    Returns
    -------
    anywidget.AnyWidget
        The widget.

    Raises
    ------
    MissingExtraError
        anywidget is not installed.

    Examples
    --------
    >>> import cogsplat
    >>> from cogsplat.tools.delivery.notebook import respond
    >>> with cogsplat.open("scene.cogs") as file:
    ...     content, buffers = respond(file, {"type": "read", "id": 1, "offset": 0, "length": 4})
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

    widget: Any = anywidget.AnyWidget(_esm=_script("viewer.js"))

    def on_message(_widget: object, message: object, _buffers: object) -> None:
        content, buffers = respond(file, message)
        widget.send(content, buffers)

    widget.on_msg(on_message)
    return widget


def bundle(file: CogsFile) -> Any:
    """Return the MIME bundle of an open file for a notebook: the widget, or text without anywidget.

    The text has the file's name and size. Jupyter calls this through ``_repr_mimebundle_``.
    """
    text = (
        f"{file.name}: {file.root.splats:,} splats, SH degree {file.root.sh_degree}, "
        f"{file.file_length:,} bytes"
    )
    try:
        widget = show(file)
    except MissingExtraError as error:
        return {"text/plain": f"{text}\n{error}"}
    found = widget._repr_mimebundle_()
    data, metadata = found if isinstance(found, tuple) else (found, {})
    return {**data, "text/plain": text}, metadata


def respond(file: CogsFile, message: object) -> tuple[dict[str, object], list[bytes]]:
    """Return the response to a message of the browser (``tools/web/src/viewer/notebook.ts``).

    Parameters
    ----------
    file : CogsFile
        Open file of the scene.
    message : object
        Request. ``{"type": "open"}`` requests the scene's name and length, and further scripts;
        ``{"type": "read", "id", "offset", "length"}`` requests bytes. Any other value gets a
        response of type ``"failed"``.

    Returns
    -------
    content : dict
        The response as JSON, with the ``id`` of the request.
    buffers : list of bytes
        The requested bytes.
    """
    match message:
        case {"type": "open"}:
            return {
                "type": "scene",
                "name": PurePath(file.name).name,
                "length": file.source_bytes,
                "programs": [_script(name) for name in _FURTHER_SCRIPTS],
            }, []
        case {"type": "read", "id": int(key), "offset": int(offset), "length": int(length)}:
            if not (offset >= 0 and 0 <= length <= _MAX_READ_BYTES):
                return {"type": "failed", "id": key, "message": f"{length} bytes requested"}, []
            try:
                part = file.read_bytes(offset, length)
            except (CogsplatError, ValueError) as error:
                # Reading from a closed file raises ValueError.
                return {"type": "failed", "id": key, "message": str(error)}, []
            return {"type": "bytes", "id": key}, [part]
        case _:
            return {"type": "failed", "id": -1, "message": "unknown message"}, []


def _script(name: str) -> str:
    """Return a script of the built viewer."""
    return files("cogsplat.tools").joinpath("web", "dist", name).read_text(encoding="utf-8")
