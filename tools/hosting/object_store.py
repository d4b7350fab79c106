"""Objects of a bucket in S3, Google Cloud Storage or Azure, through obstore."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Final

from cogsplat.codec.errors import StorageError
from cogsplat.formats.network.store_errors import first_line, obstore_module, store_errors
from cogsplat.formats.network.urls import STORE_SCHEMES, scheme_of

if TYPE_CHECKING:
    from obstore.store import ObjectStore


# A manifest has 128 pages of 1 MiB at most, and the places of 2^20 segments.
_MAX_READ_BYTES: Final = 256 << 20

# A server could list objects without end.
_MAX_OBJECTS: Final = 1 << 22


@dataclass(frozen=True)
class StoredObject:
    """An object of a bucket.

    Parameters
    ----------
    name : str
        Name relative to the bucket's prefix.
    size : int
        Size, bytes.
    modified : datetime
        Time of the last write, with time zone.
    """

    name: str
    size: int
    modified: datetime


class Bucket:
    """The objects below an address such as ``s3://bucket/prefix``.

    Parameters
    ----------
    url : str
        Address of scheme ``s3``, ``gs`` or ``az``. obstore reads credentials from the environment,
        e.g. ``AWS_ACCESS_KEY_ID``.
    config : mapping of str to str
        Configuration of obstore's store, e.g. ``endpoint`` and ``region``.
    store : ObjectStore, optional
        Store to use instead of opening `url`.

    Raises
    ------
    MissingExtraError
        ``needs-cloud``: obstore is not installed.
    StorageError
        ``bucket-address``: the address or the configuration is invalid.
    """

    def __init__(
        self,
        url: str,
        config: Mapping[str, str] | None = None,
        store: ObjectStore | None = None,
    ) -> None:
        from_url = obstore_module().store.from_url
        self.name = url.rstrip("/")
        settings = dict(config or {})
        if store is None and scheme_of(url) not in STORE_SCHEMES:
            schemes = ", ".join(f"{scheme}://" for scheme in STORE_SCHEMES)
            raise StorageError("bucket-address", f"{url}: is no bucket, expected one of {schemes}")
        plain = settings.get("endpoint", "").startswith("http://")
        # The type of `config` depends on the scheme, so its check is disabled.
        open_store: Callable[..., ObjectStore] = from_url
        try:
            self._store = store or open_store(
                self.name, config=settings, client_options={"allow_http": plain}
            )
        except Exception as error:
            # obstore raises exceptions of many types for a bad address.
            raise StorageError("bucket-address", f"{url}: {first_line(error)}") from error

    def objects(self, folder: str = "") -> Iterator[StoredObject]:
        """Yield all objects below a folder, recursively.

        Raises
        ------
        StorageError
            ``permission``, ``not-found`` or ``bucket-failed``.
        """
        import obstore

        count = 0
        with self._errors(folder):
            for block in obstore.list(self._store, folder or None):
                count += len(block)
                if count > _MAX_OBJECTS:
                    raise StorageError(
                        "bucket-failed",
                        f"{self.name}/{folder}: more than {_MAX_OBJECTS} objects, expected a "
                        "prefix that holds fewer",
                    )
                for entry in block:
                    yield StoredObject(entry["path"], entry["size"], entry["last_modified"])

    def top_objects(self) -> list[StoredObject]:
        """Return the objects directly below the prefix; raises like `objects`."""
        import obstore

        with self._errors(""):
            found = obstore.list_with_delimiter(self._store)["objects"]
        return [StoredObject(x["path"], x["size"], x["last_modified"]) for x in found]

    def read(self, name: str) -> bytes | None:
        """Return the bytes of an object, None if it does not exist; raises like `objects`.

        An object above 256 MiB, which no manifest needs, is ``bucket-failed``.
        """
        import obstore

        body = bytearray()
        try:
            with self._errors(name):
                for part in obstore.get(self._store, name).stream():
                    body += part
                    if len(body) > _MAX_READ_BYTES:
                        raise StorageError(
                            "bucket-failed",
                            f"{self.name}/{name}: more than {_MAX_READ_BYTES} bytes, expected a "
                            "manifest",
                        )
            return bytes(body)
        except StorageError as error:
            if error.code == "not-found":
                return None
            raise

    def write(self, name: str, data: bytes, headers: Mapping[str, str]) -> None:
        """Write an object and the HTTP headers to serve it with; raises like `objects`."""
        import obstore

        with self._errors(name):
            obstore.put(self._store, name, data, attributes=dict(headers))

    def delete(self, names: Sequence[str]) -> None:
        """Delete objects by name; raises like `objects`."""
        import obstore

        with self._errors(""):
            obstore.delete(self._store, list(names))

    def _errors(self, name: str) -> AbstractContextManager[None]:
        """Turn exceptions of obstore into errors that name an object."""
        where = f"{self.name}/{name}".rstrip("/")
        return store_errors(where, lambda message: StorageError("bucket-failed", message))
