"""Metadata of a COGS file that does not come from its splats: writer, first look, cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode.encoded import EncodedScene
from cogsplat.codec.views.first_look import FirstLook

from . import scene_writer as cogs
from .description import Description

try:
    _WRITER = f"cogsplat {version('cogsplat')}"
except PackageNotFoundError:  # a bare checkout on the path, never installed
    _WRITER = "cogsplat 0+unknown"


@dataclass(frozen=True, eq=False)
class FileMetadata:
    """Writer, first look, cameras and description that a file stores next to its scene.

    Parameters
    ----------
    look : FirstLook
        Up direction, first view and core box.
    cameras : sequence of Camera
        Cameras stored for readers of the file.
    description : Description or None
        Description of the scene, with the files of its pictures.
    writer : str
        Name and version of the program.
    """

    look: FirstLook = cogs.NO_LOOK
    cameras: Sequence[Camera] = ()
    description: Description | None = None
    writer: str = _WRITER

    def file_bytes(self, scene: EncodedScene) -> int:
        """Return the size of the file that `save` would write, bytes.

        Parameters
        ----------
        scene : EncodedScene
            Scene to store.
        """
        return cogs.size_bytes(
            scene,
            writer=self.writer,
            look=self.look,
            cameras=self.cameras,
            description=self.description,
        )

    def save(self, scene: EncodedScene, path: Path, *, force: bool = False) -> int:
        """Write an encoded scene as a COGS file and return its size, bytes.

        Parameters
        ----------
        scene : EncodedScene
            Scene to store.
        path : Path
            Output file.
        force : bool
            Replace an existing file.

        Raises
        ------
        StorageError
            ``exists``, ``disk-full``, ``permission``, ``not-found`` or ``io``.
        DataError
            ``root-size``, ``bad-scene-info``, ``too-many-cameras``, ``bad-camera`` or
            ``bad-description``.
        """
        return cogs.save(
            scene,
            path,
            writer=self.writer,
            look=self.look,
            cameras=self.cameras,
            description=self.description,
            force=force,
        )
