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

from .backoff import TransientError
from .network_options import NetworkOptions
from .range_responses import RangeResponse, ResponseHead
from .urls import redacted

# Minimum size of the parts in which obstore passes a body on.
_PART_BYTES: Final = 16384

# Environment variables in which obstore looks for the address of the store's server.
_ENDPOINTS: Final = ("AWS_ENDPOINT", "AWS_ENDPOINT_URL")


class ObjectTransport:
    """Transport for an object of an object store; see `Transport`.

    Parameters
    ----------
    url : str
        ``s3://bucket/key``, ``gs://bucket/key`` or ``az://container/key``.
    options : NetworkOptions
        Timeouts, and the store's configuration (`NetworkOptions.options_of_store`).
    store : obstore store, optional
        Store of the bucket to share with another transport; a new one by default.

    Raises
    ------
    MissingExtraError
        ``needs-cloud``: obstore is not installed.
    StorageError
        ``store-options``: obstore refuses the store's configuration.
    """

    def __init__(self, url: str, options: NetworkOptions, store: Any = None) -> None:
        self._obstore = _obstore()
        self._key = urlsplit(url).path.lstrip("/")
        self._url = url
        self._name = redacted(url)
        self._options = options
        # obstore does not retry by itself: retries are counted in one place, `Backoff`.
        self._store = object_store(url, options, retries=0) if store is None else store

    def sibling(self, name: str) -> ObjectTransport:
        """Return a transport for the object `name`, relative to this one, in the same store."""
        folder, slash, _ = self._url.rpartition("/")
        return ObjectTransport(f"{folder}{slash}{name}", self._options, self._store)

    @asynccontextmanager
    async def get(
        self, first: int, end: int, *, bypass_caches: bool = False
    ) -> AsyncIterator[RangeResponse]:
        """Request a range; see `Transport.get`. Stores have no caches to bypass."""
        exceptions = self._obstore.exceptions
        try:
            pending = self._obstore.get_async(
                self._store, self._key, options={"range": (first, end)}
            )
            found = await asyncio.wait_for(pending, self._options.idle_seconds)
            start, stop = found.range
            size = int(found.meta["size"])
            if start != first or not first < stop <= end:
                raise StorageError(
                    "answer-range",
                    f"{self._name}: a response of bytes {start} to {stop - 1}, expected {first} "
                    f"to {end - 1} or their beginning",
                )
            etag = found.meta["e_tag"]
            strong = etag if etag is not None and etag.startswith('"') else None
            head = ResponseHead(start, stop, size, strong, is_whole=False)
            yield RangeResponse(head, self._parts(found.stream(min_chunk_size=_PART_BYTES)))
        except TimeoutError as error:
            raise TransientError(
                "network-timeout",
                f"{self._name}: no byte for {self._options.idle_seconds:g} s, expected a response",
            ) from error
        except FileNotFoundError as error:
            raise StorageError(
                "not-found",
                f"{self._name}: the store has no such object, expected it; check the URL",
            ) from error
        except (exceptions.PermissionDeniedError, exceptions.UnauthenticatedError) as error:
            raise StorageError(
                "permission",
                f"{self._name}: the store refuses access: {first_line(error)}; check the "
                "credentials",
            ) from error
        except exceptions.PreconditionError as error:
            raise StorageError(
                "source-changed",
                f"{self._name}: the object changed while it was read: {first_line(error)}; open "
                "it again",
            ) from error
        except exceptions.BaseError as error:
            raise TransientError(
                "connection-broken", f"{self._name}: {first_line(error)}"
            ) from error

    async def _parts(self, stream: Any) -> AsyncIterator[bytes]:
        """Yield the parts of a body; each must arrive within `idle_seconds`."""
        parts = aiter(stream)
        while True:
            try:
                part = await asyncio.wait_for(anext(parts), self._options.idle_seconds)
            except StopAsyncIteration:
                return
            yield bytes(part)

    async def close(self) -> None:
        """Do nothing: obstore closes the connections when the store is freed."""


def object_store(url: str, options: NetworkOptions, *, retries: int) -> Any:
    """Return an obstore client for the bucket of an object.

    Parameters
    ----------
    url : str
        ``s3://bucket/key``, ``gs://bucket/key`` or ``az://container/key``.
    options : NetworkOptions
        Connection timeout, and the store's configuration (`options_of_store`), which comes from
        the environment by default.
    retries : int
        Number of retries that obstore makes itself.

    Raises
    ------
    MissingExtraError
        ``needs-cloud``: obstore is not installed.
    StorageError
        ``store-options``: obstore refuses the store's configuration.
    """
    obstore = _obstore()
    parts = urlsplit(url)
    client = {"connect_timeout": f"{options.connect_seconds:g}s"}
    named = [options.options_of_store.get("endpoint"), *map(os.environ.get, _ENDPOINTS)]
    if next(filter(None, named), "").startswith("http://"):
        # An endpoint without TLS, such as one on localhost, is the user's choice.
        client["allow_http"] = "true"
    try:
        return obstore.store.from_url(
            f"{parts.scheme}://{parts.netloc}",
            config=dict(options.options_of_store),
            client_options=client,
            retry_config={"max_retries": retries},
        )
    except (obstore.exceptions.BaseError, ValueError) as error:
        raise StorageError(
            "store-options",
            f"{redacted(url)}: {first_line(error)}, expected options that obstore knows",
        ) from error


def first_line(error: Exception) -> str:
    """Return the first line of an error's message; obstore adds internal details below it."""
    return str(error).strip().partition("\n")[0]


def _obstore() -> ModuleType:
    """Return the module obstore, or raise ``needs-cloud``."""
    try:
        import obstore
        import obstore.exceptions
        import obstore.store
    except ImportError as error:
        raise MissingExtraError(
            "needs-cloud",
            "obstore is not installed, expected it for object stores "
            "(pip install 'cogsplat[cloud]')",
        ) from error
    return obstore
