"""Upload files to object stores (S3, Google Cloud Storage, Azure) through obstore."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Final

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage.atomic import TargetExistsError

from .network_options import NetworkOptions
from .object_transport import object_key, object_store
from .store_errors import store_errors
from .urls import redacted

# no-transform: scenes are compressed already. no-cache: clients revalidate their copy.
_HEADERS: Final = {
    "Content-Type": "application/octet-stream",
    "Cache-Control": "no-cache, no-transform",
}


class ObjectOutput:
    """Target of an upload to an object store.

    Parameters
    ----------
    url : str
        ``s3://bucket/key``, ``gs://bucket/key`` or ``az://container/key``.
    options : NetworkOptions, optional
        Retries, and the store's configuration (`NetworkOptions.options_of_store`), which comes
        from the environment by default.

    Raises
    ------
    MissingExtraError
        ``needs-cloud``: obstore is not installed.
    StorageError
        ``store-options``: obstore refuses the store's configuration; ``bad-url``: the URL is
        malformed.

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
        self._key = object_key(url)
        self.name = redacted(url)

    def size(self) -> int | None:
        """Return the size of the existing object, bytes; None where there is none.

        Raises
        ------
        StorageError
            ``permission`` or ``store-failed``.
        """
        import obstore

        try:
            with self._store_errors():
                return int(obstore.head(self._store, self._key)["size"])
        except StorageError as error:
            if error.code == "not-found":
                return None
            raise

    def require_absent(self) -> None:
        """Raise an error if the object exists.

        Raises
        ------
        TargetExistsError
            ``exists``. Exit code 2.
        StorageError
            ``permission`` or ``store-failed``.
        """
        if self.size() is not None:
            raise TargetExistsError(self.name)

    def write(self, path: Path, *, force: bool = False) -> None:
        """Upload a file, in several parts if it is large; the object appears with the last part.

        Parameters
        ----------
        path : Path
            Local file.
        force : bool
            Whether to replace an existing object.

        Raises
        ------
        TargetExistsError
            ``exists``. Exit code 2.
        StorageError
            ``permission`` or ``store-failed``.
        """
        import obstore

        if not force:
            # Checked first, because stores support no precondition for multipart uploads.
            self.require_absent()
        try:
            with self._store_errors():
                obstore.put(self._store, self._key, path, attributes=dict(_HEADERS))
        except StorageError as error:
            if error.code == "not-found":
                raise StorageError(
                    "store-failed", f"{self.name}: the store has no such bucket, expected it"
                ) from error
            raise

    def _store_errors(self) -> AbstractContextManager[None]:
        """Turn exceptions of obstore in the block into `StorageError`."""
        return store_errors(self.name, lambda message: StorageError("store-failed", message))
