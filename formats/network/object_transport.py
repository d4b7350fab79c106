"""Range requests to object stores (S3, Google Cloud Storage, Azure) through obstore."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, asynccontextmanager
from typing import Any, Final

from cogsplat.codec.errors import StorageError

from .backoff import TransientError
from .network_options import NetworkOptions
from .range_responses import RangeResponse, ResponseHead, late, timely
from .store_errors import first_line, obstore_module, store_errors
from .urls import bad_url, redacted, split_url

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
        ``store-options``: obstore refuses the store's configuration; ``bad-url``: the URL is
        malformed; ``private-address``: `NetworkOptions.allow_private` is False.
    """

    def __init__(self, url: str, options: NetworkOptions, store: Any = None) -> None:
        self._obstore = obstore_module()
        self._key = object_key(url)
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
        idle = self._options.idle_seconds
        options = {"range": (first, end)}
        try:
            with self._store_errors():
                pending = self._obstore.get_async(self._store, self._key, options=options)
                found = await asyncio.wait_for(pending, idle)
                # obstore parses the headers here.
                meta, (start, stop) = found.meta, found.range
        except TimeoutError as error:
            raise late(self._name, idle) from error
        size = int(meta["size"])
        if start != first or not first < stop <= end:
            raise StorageError(
                "answer-range",
                f"{self._name}: a response of bytes {start} to {stop - 1}, expected {first} "
                f"to {end - 1} or their beginning",
            )
        etag = meta["e_tag"]
        strong = etag if etag is not None and etag.startswith('"') else None
        head = ResponseHead(start, stop, size, strong, is_whole=False)
        yield RangeResponse(head, timely(self._parts(found), idle, self._name))

    async def _parts(self, found: Any) -> AsyncIterator[bytes]:
        """Yield the parts of a body as they arrive."""
        with self._store_errors():
            parts = aiter(found.stream(min_chunk_size=_PART_BYTES))
        while True:
            with self._store_errors():
                part = await anext(parts, None)
            if part is None:
                return
            yield bytes(part)

    def _store_errors(self) -> AbstractContextManager[None]:
        """Turn exceptions of obstore in the block into `StorageError` or `TransientError`."""
        return store_errors(
            self._name, lambda message: TransientError("connection-broken", message)
        )

    async def close(self) -> None:
        """Do nothing: obstore closes the connections when the store is freed."""


def object_key(url: str) -> str:
    """Return the key of an object by its URL; raise ``bad-url`` for a key that stores refuse."""
    key = split_url(url).path.lstrip("/")
    if any(step in ("", ".", "..") for step in key.split("/")):
        raise bad_url(url, "an empty step, . or .. in its path")
    return key


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
        ``store-options``: obstore refuses the store's configuration; ``bad-url``: the URL is
        malformed; ``private-address``: `NetworkOptions.allow_private` is False.
    """
    obstore = obstore_module()
    parts = split_url(url)
    if not options.allow_private:
        raise StorageError(
            "private-address",
            f"{redacted(url)}: object stores are read with the credentials of this machine, "
            "expected http or https where private addresses are not allowed",
        )
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
    except Exception as error:
        # obstore raises exceptions of many types for options that it does not know.
        raise StorageError(
            "store-options",
            f"{redacted(url)}: {first_line(error)}, expected options that obstore knows",
        ) from error
