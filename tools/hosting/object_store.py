"""Objects of a bucket, over S3 and what is like it, by obstore."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from cogsplat.codec.errors import MissingExtraError, StorageError
from cogsplat.formats.network.urls import STORE_SCHEMES, scheme_of

if TYPE_CHECKING:
    from obstore.store import ObjectStore


@dataclass(frozen=True)
class StoredObject:
    """An object of a bucket.

    Parameters
    ----------
    name : str
        Below the prefix of the store.
    size : int
        Bytes.
    modified : datetime
        When it was written, with its time zone.
    """

    name: str
    size: int
    modified: datetime


class Bucket:
    """The objects below an address such as ``s3://bucket/prefix``.

    Parameters
    ----------
    url : str
        ``s3://``, ``gs://`` or ``az://``. Credentials come from the environment, as obstore reads
        them: ``AWS_ACCESS_KEY_ID`` and so on.
    config : mapping of str to str
        Of obstore's store, such as ``endpoint`` and ``region``.
    store : ObjectStore, optional
        In place of the one that the address names.

    Raises
    ------
    MissingExtraError
        ``needs-cloud``: obstore is not installed.
    StorageError
        ``bucket-address``: the address or the configuration is none.
    """

    def __init__(
        self,
        url: str,
        config: Mapping[str, str] | None = None,
        store: ObjectStore | None = None,
    ) -> None:
        try:
            from obstore.store import from_url
        except ImportError as error:
            raise MissingExtraError(
                "needs-cloud",
                "buckets are read and written with obstore (pip install 'cogsplat[cloud]')",
            ) from error
        self.name = url.rstrip("/")
        settings = dict(config or {})
        if store is None and scheme_of(url) not in STORE_SCHEMES:
            schemes = ", ".join(f"{scheme}://" for scheme in STORE_SCHEMES)
            raise StorageError("bucket-address", f"{url}: is no bucket, expected one of {schemes}")
        plain = urlsplit(settings.get("endpoint", "")).scheme == "http"
        # Which keys a configuration has depends on the address, which types cannot say.
        made: Callable[..., ObjectStore] = from_url
        try:
            self._store = store or made(
                self.name, config=settings, client_options={"allow_http": plain}
            )
        except Exception as error:
            # What obstore raises for addresses is of many types.
            raise StorageError("bucket-address", f"{url}: {_first_line(error)}") from error

    def objects(self, folder: str = "") -> Iterator[StoredObject]:
        """Yield the objects below a folder, those of folders in it too.

        Raises
        ------
        StorageError
            ``permission``, ``not-found`` or ``bucket-failed``.
        """
        import obstore

        with self._errors(folder):
            for block in obstore.list(self._store, folder or None):
                for entry in block:
                    yield StoredObject(entry["path"], entry["size"], entry["last_modified"])

    def top_objects(self) -> list[StoredObject]:
        """Return the objects that are in no folder; raises as `objects`."""
        import obstore

        with self._errors(""):
            found = obstore.list_with_delimiter(self._store)["objects"]
        return [StoredObject(x["path"], x["size"], x["last_modified"]) for x in found]

    def read(self, name: str) -> bytes | None:
        """Return an object, None where it is not there; raises as `objects`."""
        import obstore

        try:
            with self._errors(name):
                return obstore.get(self._store, name).bytes().to_bytes()
        except StorageError as error:
            if error.code == "not-found":
                return None
            raise

    def write(self, name: str, data: bytes, headers: Mapping[str, str]) -> None:
        """Write an object with the headers that it is served with; raises as `objects`."""
        import obstore

        with self._errors(name):
            obstore.put(self._store, name, data, attributes=dict(headers))

    def delete(self, names: Sequence[str]) -> None:
        """Delete objects; raises as `objects`."""
        import obstore

        with self._errors(""):
            obstore.delete(self._store, list(names))

    @contextmanager
    def _errors(self, name: str) -> Iterator[None]:
        from obstore import exceptions

        where = f"{self.name}/{name}".rstrip("/")
        try:
            yield
        except FileNotFoundError as error:
            raise StorageError("not-found", f"{where}: {_first_line(error)}") from error
        except (
            PermissionError,
            exceptions.PermissionDeniedError,
            exceptions.UnauthenticatedError,
        ) as error:
            raise StorageError("permission", f"{where}: {_first_line(error)}") from error
        except (exceptions.BaseError, OSError) as error:
            raise StorageError("bucket-failed", f"{where}: {_first_line(error)}") from error


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0][:300]
