"""Write files as objects of a store (S3, Google Cloud Storage, Azure) through obstore."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage.atomic import TargetExistsError

from .object_transport import first_line, object_store
from .options import NetworkOptions
from .urls import shown

# Scenes are compressed already; whoever has an older one asks whether there is a new one.
_HEADERS: Final = {
    "Content-Type": "application/octet-stream",
    "Cache-Control": "no-cache, no-transform",
}


class ObjectOutput:
    """An object of a store that a file is to become.

    Parameters
    ----------
    url : str
        ``s3://bucket/key``, ``gs://bucket/key`` or ``az://container/key``.
    options : NetworkOptions, optional
        `NetworkOptions.options_of_store` configures the store; the environment does otherwise.

    Raises
    ------
    MissingExtraError
        ``needs-cloud``: obstore is not installed.
    StorageError
        ``store-options``: the store cannot be configured so.

    Examples
    --------
    .. code-block:: python

        from pathlib import Path

        from cogsplat.formats.network.object_output import ObjectOutput

        ObjectOutput("s3://bucket/scene.cogs").write(Path("scene.cogs"), force=True)
    """

    def __init__(self, url: str, options: NetworkOptions | None = None) -> None:
        options = options or NetworkOptions()
        self._store: Any = object_store(url, options, retries=options.retries)
        self._key = urlsplit(url).path.lstrip("/")
        self.name = shown(url)

    def size(self) -> int | None:
        """Return the bytes of the object that is there; None where there is none.

        Raises
        ------
        StorageError
            ``permission`` or ``store-failed``.
        """
        import obstore

        try:
            return int(obstore.head(self._store, self._key)["size"])
        except FileNotFoundError:
            return None
        except (obstore.exceptions.BaseError, OSError) as error:
            raise self._failed(error) from error

    def require_absent(self) -> None:
        """Refuse an object that is there.

        Raises
        ------
        TargetExistsError
            ``exists``. Exit code 2.
        StorageError
            As `size`.
        """
        if self.size() is not None:
            raise TargetExistsError(self.name)

    def write(self, path: Path, *, force: bool = False) -> None:
        """Send a file; large ones go in several parts, and the object is there with the last.

        Parameters
        ----------
        path : Path
        force : bool
            Replace an object that is there.

        Raises
        ------
        TargetExistsError
            ``exists``. Exit code 2.
        StorageError
            As `size`.
        """
        import obstore

        if not force:
            # Asked first: stores take no condition for objects that come in parts.
            self.require_absent()
        try:
            obstore.put(self._store, self._key, path, attributes=dict(_HEADERS))
        except (obstore.exceptions.BaseError, OSError) as error:
            raise self._failed(error) from error

    def _failed(self, error: Exception) -> StorageError:
        import obstore

        refused = (
            PermissionError,
            obstore.exceptions.PermissionDeniedError,
            obstore.exceptions.UnauthenticatedError,
        )
        if isinstance(error, refused):
            return StorageError(
                "permission", f"{self.name}: the store refuses access: {first_line(error)}"
            )
        return StorageError("store-failed", f"{self.name}: {first_line(error)}")
