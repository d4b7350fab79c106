"""Range requests to object stores (S3, Google Cloud Storage, Azure) through obstore."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import ModuleType
from typing import Any, Final
from urllib.parse import urlsplit

from cogsplat.codec.errors import MissingExtraError, StorageError

from .answers import Answer, Stated
from .faults import PassingFault
from .options import NetworkOptions
from .urls import shown

# obstore makes chunks of at least so many bytes of what arrives.
_PART_BYTES: Final = 16384

# Where the environment names the server of a store, as obstore reads it.
_ENDPOINTS: Final = ("AWS_ENDPOINT", "AWS_ENDPOINT_URL")


class ObjectTransport:
    """Asks an object store for ranges of one object; see `answers.Transport`.

    Parameters
    ----------
    url : str
        ``s3://bucket/key``, ``gs://bucket/key`` or ``az://container/key``.
    options : NetworkOptions
        `NetworkOptions.options_of_store` configures the store.
    store : obstore store, optional
        That the address names, in place of a new one.

    Raises
    ------
    MissingExtraError
        ``needs-cloud``: obstore is not installed.
    StorageError
        ``store-options``: the store cannot be configured so.
    """

    def __init__(self, url: str, options: NetworkOptions, store: Any = None) -> None:
        self._obstore = _obstore()
        self._key = urlsplit(url).path.lstrip("/")
        self._url = url
        self._name = shown(url)
        self._options = options
        # Attempts are counted, and paused, in one place: `faults.Backoff`.
        self._store = object_store(url, options, retries=0) if store is None else store

    def beside(self, name: str) -> ObjectTransport:
        """Return a transport of an object that is named relative to this one, of the same store."""
        folder, slash, _ = self._url.rpartition("/")
        return ObjectTransport(f"{folder}{slash}{name}", self._options, self._store)

    @asynccontextmanager
    async def get(self, first: int, end: int, *, fresh: bool = False) -> AsyncIterator[Answer]:
        """Ask for a range; see `answers.Transport.get`. Stores have no caches to go around."""
        exceptions = self._obstore.exceptions
        try:
            asked = self._obstore.get_async(self._store, self._key, options={"range": (first, end)})
            found = await asyncio.wait_for(asked, self._options.idle_seconds)
            start, stop = found.range
            size = int(found.meta["size"])
            if start != first or not first < stop <= end:
                raise StorageError(
                    "answer-range",
                    f"{self._name}: an answer of bytes {start} to {stop - 1}, expected {first} to "
                    f"{end - 1} or their beginning",
                )
            etag = found.meta["e_tag"]
            strong = etag if etag is not None and etag.startswith('"') else None
            stated = Stated(start, stop, size, strong, is_whole=False)
            yield Answer(stated, self._parts(found.stream(min_chunk_size=_PART_BYTES)))
        except TimeoutError as error:
            raise PassingFault(
                "network-timeout",
                f"{self._name}: nothing came for {self._options.idle_seconds:g} s",
            ) from error
        except FileNotFoundError as error:
            raise StorageError(
                "not-found", f"{self._name}: the store has no such object"
            ) from error
        except (exceptions.PermissionDeniedError, exceptions.UnauthenticatedError) as error:
            raise StorageError(
                "permission", f"{self._name}: the store refuses access: {first_line(error)}"
            ) from error
        except exceptions.PreconditionError as error:
            raise StorageError(
                "source-changed", f"{self._name}: is another object now: {first_line(error)}"
            ) from error
        except exceptions.BaseError as error:
            raise PassingFault("connection-broken", f"{self._name}: {first_line(error)}") from error

    async def _parts(self, stream: Any) -> AsyncIterator[bytes]:
        """Give the parts of an answer, none of which may be waited for too long."""
        parts = aiter(stream)
        while True:
            try:
                part = await asyncio.wait_for(anext(parts), self._options.idle_seconds)
            except StopAsyncIteration:
                return
            yield bytes(part)

    async def close(self) -> None:
        """Do nothing: the store's connections end with it."""


def object_store(url: str, options: NetworkOptions, *, retries: int) -> Any:
    """Return obstore's store of an object's bucket.

    Parameters
    ----------
    url : str
        ``s3://bucket/key``, ``gs://bucket/key`` or ``az://container/key``.
    options : NetworkOptions
        Its `options_of_store` configures the store; the environment does otherwise.
    retries : int
        Times that obstore makes a request again by itself.

    Raises
    ------
    MissingExtraError
        ``needs-cloud``: obstore is not installed.
    StorageError
        ``store-options``: the store cannot be configured so.
    """
    obstore = _obstore()
    parts = urlsplit(url)
    client = {"connect_timeout": f"{options.connect_seconds:g}s"}
    named = [options.options_of_store.get("endpoint"), *map(os.environ.get, _ENDPOINTS)]
    if next(filter(None, named), "").startswith("http://"):
        # Whoever names an endpoint without TLS, as one of this machine, means it.
        client["allow_http"] = "true"
    try:
        return obstore.store.from_url(
            f"{parts.scheme}://{parts.netloc}",
            config=dict(options.options_of_store),
            client_options=client,
            retry_config={"max_retries": retries},
        )
    except (obstore.exceptions.BaseError, ValueError) as error:
        raise StorageError("store-options", f"{shown(url)}: {first_line(error)}") from error


def first_line(error: Exception) -> str:
    """Return the first line of a message; obstore prints its insides below."""
    return str(error).strip().partition("\n")[0]


def _obstore() -> ModuleType:
    try:
        import obstore
        import obstore.exceptions
        import obstore.store
    except ImportError as error:
        raise MissingExtraError(
            "needs-cloud",
            "object stores are read with obstore (pip install 'cogsplat[cloud]')",
        ) from error
    return obstore
