"""HTTP transport that connects to public addresses alone, for servers that open users' URLs."""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import ssl
from collections.abc import AsyncIterator, Iterable
from typing import Final

import httpcore
import httpx

from cogsplat.codec.errors import StorageError

_Address = ipaddress.IPv4Address | ipaddress.IPv6Address

# Networks that `is_global` misses: 168.63.129.16 is Azure's metadata service. The others are
# reserved (RFC 6890, 9602, 9637), which older versions of Python do not know.
_NOT_PUBLIC: Final = tuple(
    map(
        ipaddress.ip_network,
        ("168.63.129.16/32", "192.0.0.0/24", "2001::/23", "3fff::/20", "5f00::/16", "fec0::/10"),
    )
)

# Prefixes whose addresses end in an IPv4 address: NAT64 (RFC 6052), and its local form (RFC 8215).
_NAT64: Final = (
    ipaddress.ip_network("64:ff9b::/96"),
    ipaddress.ip_network("64:ff9b:1::/48"),
)


class PublicTransport(httpx.AsyncBaseTransport):
    """Transport of httpx over HTTP/1.1 and HTTP/2 that refuses private addresses.

    A host name is resolved once for a connection, its addresses are checked, and the connection
    goes to a checked address. A name server therefore cannot return another address after the
    check. Proxies of the environment are not used, because they would resolve names themselves.

    Parameters
    ----------
    certificates : ssl.SSLContext
        Trusted certificate authorities.
    connections : int
        Maximum number of connections.
    """

    def __init__(self, certificates: ssl.SSLContext, connections: int) -> None:
        self._pool = httpcore.AsyncConnectionPool(
            ssl_context=certificates,
            max_connections=connections,
            http2=True,
            network_backend=_PublicBackend(),
        )

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        """Send a request to a public address.

        Raises
        ------
        StorageError
            ``private-address``.
        Exception
            The exceptions of httpcore.
        """
        url = request.url
        response = await self._pool.handle_async_request(
            httpcore.Request(
                method=request.method,
                url=httpcore.URL(
                    scheme=url.raw_scheme, host=url.raw_host, port=url.port, target=url.raw_path
                ),
                headers=request.headers.raw,
                extensions=request.extensions,
            )
        )
        return httpx.Response(
            status_code=response.status,
            headers=response.headers,
            stream=_Body(response),
            extensions=response.extensions,
        )

    async def aclose(self) -> None:
        """Close all connections."""
        await self._pool.aclose()


class _Body(httpx.AsyncByteStream):
    """Body of a response of httpcore."""

    def __init__(self, response: httpcore.Response) -> None:
        self._response = response

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async for part in self._response.aiter_stream():
            yield part

    async def aclose(self) -> None:
        await self._response.aclose()


class _PublicBackend(httpcore.AsyncNetworkBackend):
    """Network backend of httpcore that connects to public addresses alone."""

    def __init__(self) -> None:
        self._network = httpcore.AnyIOBackend()

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        """Connect to a public address of a host.

        Raises
        ------
        StorageError
            ``private-address``: the host has no public address.
        """
        addresses = await _resolve(host, port)
        public = [address for address in addresses if is_public(address)]
        if not public:
            # The addresses are not named: users could map a private network by messages.
            raise StorageError(
                "private-address",
                f"{host}: has no public address, expected one; private addresses are not allowed",
            )
        for address in public[:-1]:
            try:
                return await self._network.connect_tcp(
                    str(address), port, timeout, local_address, socket_options
                )
            except (httpcore.ConnectError, httpcore.ConnectTimeout):
                # The host's next address may answer.
                continue
        return await self._network.connect_tcp(
            str(public[-1]), port, timeout, local_address, socket_options
        )

    async def connect_unix_socket(
        self,
        path: str,
        timeout: float | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        """Refuse a socket of this machine."""
        raise StorageError("private-address", f"{path}: a local socket, expected a public address")

    async def sleep(self, seconds: float) -> None:
        """Sleep, as httpcore does between attempts to connect."""
        await self._network.sleep(seconds)


async def _resolve(host: str, port: int) -> list[_Address]:
    """Return the addresses of a host, without duplicates, in the resolver's order."""
    try:
        found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError as error:
        raise httpcore.ConnectError(str(error)) from error
    return list(dict.fromkeys(ipaddress.ip_address(entry[4][0]) for entry in found))


def is_public(address: _Address) -> bool:
    """Whether an address, and any IPv4 address embedded in it, is reachable on the internet.

    Examples
    --------
    >>> import ipaddress
    >>> from cogsplat.formats.network.public_transport import is_public
    >>> [is_public(ipaddress.ip_address(a)) for a in ("1.1.1.1", "::ffff:127.0.0.1")]
    [True, False]
    """
    inner = _inner_address(address)
    if inner is not None:
        return is_public(inner)
    reserved = address.is_multicast or any(address in network for network in _NOT_PUBLIC)
    return address.is_global and not reserved


def _inner_address(address: _Address) -> ipaddress.IPv4Address | None:
    """Return the IPv4 address to which an IPv6 address of a transition mechanism leads."""
    if isinstance(address, ipaddress.IPv4Address):
        return None
    if any(address in network for network in _NAT64):
        return ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
    return address.ipv4_mapped or address.sixtofour
