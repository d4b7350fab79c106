"""Manifest of ``cogsplat batch``: the scenes to encode and their options."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Final

import click

from cogsplat.codec.errors import CogsplatError, DataError, FormatError
from cogsplat.formats.cameras.colmap import find_model
from cogsplat.formats.network.network_options import MIB
from cogsplat.formats.network.open_url import open_url
from cogsplat.formats.network.urls import is_url
from cogsplat.formats.scenes.input_files import input_files
from cogsplat.formats.scenes.registry import is_cogs, scene_files
from cogsplat.formats.storage.atomic import is_file, open_for_read, storage_errors
from cogsplat.formats.storage.strict_json import parse_object
from cogsplat.tools.terminal.config_file import option_values
from cogsplat.tools.terminal.standard_streams import STREAM, NamedPath, is_file_name

from .batch_log import output_key, output_keys

_KEYS: Final = frozenset({"input", "output", "options"})
_CODE: Final = "bad-manifest"

# About 80,000 scenes.
_MAX_BYTES: Final = 1 << 24


@dataclass(frozen=True)
class BatchScene:
    """One scene of a manifest.

    Parameters
    ----------
    input, output : str
        Paths relative to the folder of the manifest, or URLs.
    words : tuple of str
        Options of ``cogsplat encode``, as words of a command line.
    reads, writes : tuple of str
        Further files that options name, such as cameras and a report.
    error : CogsplatError or None
        Error of a malformed entry, which is not encoded. Its `input` and `output` are empty where
        the entry has none.
    """

    input: str
    output: str
    words: tuple[str, ...]
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    error: CogsplatError | None = None

    @property
    def inputs(self) -> tuple[str, ...]:
        """Input files and URLs of the encode; none for a malformed entry."""
        return () if self.error else (self.input, *self.reads)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Output files and URLs of the encode; none for a malformed entry."""
        return () if self.error else self.made

    @property
    def made(self) -> tuple[str, ...]:
        """Files and URLs that other scenes may read; a malformed entry has some as well."""
        return (self.output, *self.writes) if self.output else ()

    def require_well_formed(self) -> None:
        """Refuse a malformed entry, names that no command line can hold, and the stream ``-``.

        Raises
        ------
        CogsplatError
            `error`, or ``bad-manifest``.
        """
        if self.error is not None:
            raise self.error
        for text in (self.input, self.output, *self.words):
            if text == STREAM or not is_file_name(text):
                raise FormatError(_CODE, f"{text!r}, expected the name of a file, or an option")

    def fingerprint(self, folder: Path) -> str:
        """Return the SHA-256, in hexadecimal, of input bytes, output name and options.

        The bytes of files that options name count as well, of a COLMAP folder those of its model.
        For a URL, length and ETag replace the bytes if the server sends an ETag.

        Parameters
        ----------
        folder : Path
            Folder of the manifest.

        Raises
        ------
        CogsplatError
            The input cannot be read; the errors of `require_well_formed`.
        """
        self.require_well_formed()
        digest = hashlib.sha256(json.dumps([self.output, self.words]).encode())
        if is_url(self.input):
            _update_by_url(digest, self.input)
        else:
            path = folder / self.input
            _update_by_files(digest, [path] if is_cogs(path) else scene_files(path))
        for name in self.reads:
            path = folder / name
            # A missing file is found by the encode, which says what it is for.
            found = sorted(filter(is_file, input_files(find_model(path) or path)))
            digest.update(json.dumps([part.name for part in found]).encode())
            _update_by_files(digest, found)
        return digest.hexdigest()


def _update_by_files(digest: hashlib._Hash, paths: Iterable[Path]) -> None:
    """Add the bytes of files."""
    for path in paths:
        with open_for_read(path) as file, storage_errors(path):
            digest.update(hashlib.file_digest(file, "sha256").digest())


def _update_by_url(digest: hashlib._Hash, url: str) -> None:
    """Add length and ETag of a URL, or its bytes if the server sends no ETag."""
    with open_url(url) as source:
        digest.update(f"{url} {source.size} {source.etag}".encode())
        if source.etag is None:
            for start in range(0, source.size, MIB):
                digest.update(source.read(start, min(MIB, source.size - start)))


def read_manifest(path: Path, options: Mapping[str, click.Option]) -> list[BatchScene]:
    """Read a manifest: JSON lines, or TOML with one table ``[[scene]]`` per scene.

    A table ``[options]`` in TOML holds options of all scenes; those of a scene win. A malformed
    entry is a scene with a `BatchScene.error`: one that is no object, or has an unknown key or
    option.

    Parameters
    ----------
    path : Path
        TOML if the name ends in ``.toml``, else JSON lines.
    options : mapping of str to click.Option
        Options that a scene may have, by their names without dashes.

    Raises
    ------
    FormatError
        ``bad-manifest``: the file is neither, or its common options are malformed.
    DataError
        ``same-output``: two scenes have one output; ``circle-of-scenes``: scenes read each other's
        outputs.
    """
    with open_for_read(path) as file, storage_errors(path):
        data = file.read(_MAX_BYTES + 1)
    if len(data) > _MAX_BYTES:
        raise FormatError(_CODE, f"{path}: is longer than {_MAX_BYTES} bytes, expected a manifest")
    common, entries = _entries(data, path)
    try:
        option_values(options, common)
    except ValueError as error:
        raise FormatError(_CODE, f"{path}: {error}") from None
    scenes = [_scene(entry, f"{path}: {where}", options, common) for where, entry in entries]
    folder = path.absolute().parent
    used: set[str] = set()
    for scene in scenes:
        for output in filter(is_file_name, scene.outputs):
            key = output_key(folder, output)
            if key in used:
                raise DataError(
                    "same-output", f"{path}: 2 scenes with output {output!r}, expected one"
                )
            used.add(key)
    try:
        scene_order(scenes, folder).prepare()
    except CycleError as error:
        names = [scenes[number].output for number in reversed(error.args[1])]
        raise DataError(
            "circle-of-scenes",
            f"{path}: {' reads '.join(names)}, expected scenes that can be encoded one by one",
        ) from None
    return scenes


def scene_order(scenes: Sequence[BatchScene], folder: Path) -> TopologicalSorter[int]:
    """Return the order of a batch: a scene that reads the output of another one comes later.

    Parameters
    ----------
    scenes : sequence of BatchScene
        Scenes of a manifest.
    folder : Path
        Folder of the manifest.

    Returns
    -------
    TopologicalSorter of int
        Graph of the scenes' numbers, not prepared yet.
    """
    makers = {
        key: number
        for number, scene in enumerate(scenes)
        for key in output_keys(folder, scene.made)
    }
    order: TopologicalSorter[int] = TopologicalSorter()
    for number, scene in enumerate(scenes):
        read = output_keys(folder, scene.inputs)
        order.add(number, *(makers[key] for key in read if key in makers))
    return order


def _entries(data: bytes, path: Path) -> tuple[dict[str, object], list[tuple[str, object]]]:
    """Return the options of all scenes, and the place, for messages, and value of each entry.

    The value of an entry is bytes for a line of JSON.
    """
    try:
        text = data.decode()
        if path.suffix == ".toml":
            table = tomllib.loads(text)
            found, common = table.pop("scene", []), table.pop("options", {})
            if not isinstance(found, list) or not isinstance(common, dict) or table:
                raise ValueError(
                    f"keys {', '.join(sorted(table)) or 'scene, options'}, expected tables "
                    "[[scene]] and a table [options]"
                )
            return common, [(f"scene {n}", table) for n, table in enumerate(found, start=1)]
    # RecursionError: nested deeper than the parser goes.
    except (ValueError, RecursionError) as error:
        raise FormatError(
            _CODE, f"{path}: {error}, expected JSON lines, or TOML in a file called .toml"
        ) from None
    return {}, [
        (f"line {number}", line)
        for number, line in enumerate(data.split(b"\n"), start=1)
        if line.strip()
    ]


def _scene(
    entry: object, where: str, options: Mapping[str, click.Option], common: Mapping[str, object]
) -> BatchScene:
    """Return the scene of an entry, with an error if it is malformed; `where` is for messages."""
    table: object = {}
    try:
        table = parse_object(entry, where, _CODE).values if isinstance(entry, bytes) else entry
        return _well_formed_scene(table, where, options, common)
    except CogsplatError as error:
        given = table if isinstance(table, dict) else {}
        paths = [given.get("input"), given.get("output")]
        names = [path if isinstance(path, str) else "" for path in paths]
        return BatchScene(names[0], names[1], (), error=error)


def _well_formed_scene(
    table: object, where: str, options: Mapping[str, click.Option], common: Mapping[str, object]
) -> BatchScene:
    """Return the scene of an entry, or raise ``bad-manifest``."""
    if not isinstance(table, dict):
        raise FormatError(_CODE, f"{where}: {type(table).__name__}, expected an object")
    unknown = sorted(set(table) - _KEYS)
    if unknown:
        raise FormatError(_CODE, f"{where}: key {unknown[0]!r}, expected some of {sorted(_KEYS)}")
    paths = [table.get("input"), table.get("output")]
    if not all(isinstance(value, str) and value for value in paths):
        raise FormatError(
            _CODE, f"{where}: input {paths[0]!r}, output {paths[1]!r}, expected paths"
        )
    given = table.get("options", {})
    if not isinstance(given, dict):
        raise FormatError(_CODE, f"{where}: options {given!r}, expected an object")
    try:
        values = option_values(options, {**common, **given})
    except ValueError as error:
        raise FormatError(_CODE, f"{where}: {error}") from None
    words: list[str] = []
    named: dict[bool, list[str]] = {False: [], True: []}
    for name, value in values.items():
        kind = options[name].type
        if isinstance(kind, NamedPath) and isinstance(value, str):
            named[kind.is_output].append(value)
        if isinstance(value, bool):
            words += [f"--{name}"] * value
        else:
            words += [f"--{name}={text}" for text in ([value] if isinstance(value, str) else value)]
    return BatchScene(
        str(paths[0]), str(paths[1]), tuple(words), tuple(named[False]), tuple(named[True])
    )
