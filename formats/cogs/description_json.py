"""JSON form of a description: the keys of SPEC 5.13, with the files of pictures by path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import CogsplatError, DataError, FormatError
from cogsplat.formats.storage.atomic import StrPath, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.strict_json import parse_object

from .canonical_msgpack import MAX_DEPTH, Value
from .description import PICTURES, Description, Picture
from .description_segment import description_map, parse_description
from .layout import MAX_DESCRIPTION_BYTES, MAX_PICTURE_BYTES
from .picture_header import picture_header

_CODE: Final = "bad-description-file"

# Keys whose numbers are integers; all other numbers are floats.
_INTEGERS: Final = ("width", "height")

# Largest JSON text: numbers take up to three times their bytes in msgpack, escapes up to six times.
_MAX_JSON_BYTES: Final = 6 * MAX_DESCRIPTION_BYTES


def to_json(description: Description) -> dict[str, Value]:
    """Return a description as a JSON object, its pictures without their files."""
    return description_map(description)


def read_description(path: StrPath, *, limits: Limits | None = None) -> Description:
    """Read a description from a JSON file, which has the keys of SPEC 5.13.

    Parameters
    ----------
    path : path
        JSON file; paths of pictures in it are relative to its folder.
    limits : Limits, optional
        Memory limits.

    Raises
    ------
    FormatError
        ``bad-description-file``: no JSON object, an unknown key, or a value that SPEC 5.13 refuses.
    DataError
        ``bad-description``: a picture that SPEC 5.14 refuses.
    LimitError
        ``json-too-long``.
    StorageError
        The file or a picture cannot be read.

    Examples
    --------
    >>> import cogsplat
    >>> from pathlib import Path
    >>> size = Path("garden.json").write_text('{"title": "Garden", "metres_per_unit": 2}')
    >>> cogsplat.read_description("garden.json").title
    'Garden'
    """
    return from_json(read_object(Path(path), limits=limits), Path(path))


def read_object(path: Path, *, limits: Limits | None = None) -> dict[str, object]:
    """Read the JSON object of a file that is at most as long as a description can be.

    Raises
    ------
    FormatError
        ``bad-description-file``: no JSON object, or too long a file.
    LimitError
        ``json-too-long``.
    StorageError
        The file cannot be read.
    """
    data = _read_at_most(path, _MAX_JSON_BYTES, _CODE)
    return parse_object(data, str(path), _CODE, limits=limits).values


def from_json(value: Mapping[str, object], path: Path) -> Description:
    """Return the description of a JSON object; raises as `read_description`.

    Parameters
    ----------
    value : mapping
        Keys of SPEC 5.13. A picture is the path of its file, or an object with the path as ``file``
        and, for a sky, ``rotation``. With ``type``, ``width`` and ``height`` in place of ``file``,
        it is the picture that the scene has already.
    path : Path
        File of the object: its name in messages, its folder for paths of pictures.
    """
    given = dict(value)
    files: dict[str, Picture] = {}
    for name in PICTURES:
        found = given.get(name)
        entry = {"file": found} if isinstance(found, str) else found
        if not isinstance(entry, dict) or "file" not in entry:
            continue
        file = entry["file"]
        if not isinstance(file, str):
            raise FormatError(_CODE, f"{path}, {name}: file {file!r}, expected a path")
        picture = read_picture_file(path.parent / file)
        files[name] = picture
        others = {key: x for key, x in entry.items() if key != "file"}
        given[name] = {
            "type": picture.media_type,
            "width": picture.width,
            "height": picture.height,
            **others,
        }
    try:
        made = parse_description(_stored(given, "", 1), str(path))
    except CogsplatError as error:
        raise FormatError(_CODE, error.message) from error
    unknown = _unknown_key(given, to_json(made))
    if unknown:
        raise FormatError(_CODE, f"{path}: the key {unknown!r} is unknown, expected known ones")
    pictures = made.pictures()
    return made.with_pictures(
        {name: replace(pictures[name], data=file.data) for name, file in files.items()}
    )


def read_picture_file(path: Path) -> Picture:
    """Read a poster or a sky from a JPEG or WebP file.

    Raises
    ------
    DataError
        ``bad-description``: another format, a cut or an animated picture, or too large a file.
    StorageError
        The file cannot be read.
    """
    data = _read_at_most(path, MAX_PICTURE_BYTES, "bad-description")
    try:
        return Picture(*picture_header(data, str(path)), data=data)
    except FormatError as error:
        raise DataError("bad-description", error.message) from error


def _read_at_most(path: Path, most: int, code: str) -> bytes:
    """Read a file; raise a FormatError with the reason `code` if it exceeds `most` bytes."""
    with storage_errors(path), open_for_read(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise FormatError(code, f"{path}: longer than {most} bytes, expected at most as many")
    return data


def _stored(value: object, key: str, depth: int) -> Value:
    """Convert a JSON value to the types of SPEC 5.13; a value that no key can have is None.

    Parameters
    ----------
    value : object
        Value of the JSON object, at any depth.
    key : str
        Key of the value, which decides between integers and floats.
    depth : int
        Nesting depth of the value, at most `MAX_DEPTH`.
    """
    if isinstance(value, dict) and depth <= MAX_DEPTH:
        return {str(name): _stored(inner, str(name), depth + 1) for name, inner in value.items()}
    if isinstance(value, list | tuple) and depth <= MAX_DEPTH:
        return [_stored(inner, key, depth + 1) for inner in value]
    if isinstance(value, int) and not isinstance(value, bool) and key not in _INTEGERS:
        try:
            return float(value)
        except OverflowError:
            return None
    if isinstance(value, str):
        # Line ends of other systems; SPEC 5.13 refuses other control characters.
        return value.replace("\r\n", "\n")
    return value if isinstance(value, bool | int | float) else None


def _unknown_key(given: object, known: object) -> str | None:
    """Return the first key of a JSON object, at any depth, that its description does not have."""
    if isinstance(given, dict) and isinstance(known, dict):
        for key, value in given.items():
            if key not in known and value != []:
                return str(key)
            inner = _unknown_key(value, known.get(key))
            if inner:
                return inner
    elif isinstance(given, list) and isinstance(known, list):
        for value, other in zip(given, known, strict=False):
            inner = _unknown_key(value, other)
            if inner:
                return inner
    return None
