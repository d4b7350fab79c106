"""Servers that open the URLs of their users reach public addresses alone."""

import ipaddress
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpcore
import pytest
from cogs_samples import assert_same, file_of
from fault_server import Exchange, FaultServer, broken_after, right, serving, status

import cogsplat
from cogsplat.formats.cogs.open_file import open_source
from cogsplat.formats.network import public_transport
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.public_transport import is_public
from cogsplat.tools.lab.conformance.reference_folders import folder_of_file

PUBLIC = NetworkOptions(allow_private=False, pause_seconds=0.01, retries=1)


@pytest.fixture(scope="module")
def data() -> bytes:
    return file_of("vq", 6000, 3, 500)


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1", "127.8.8.8", "0.0.0.0", "10.0.0.1", "172.16.0.1", "192.168.1.1",
        "169.254.169.254", "100.64.0.1", "100.100.100.200", "168.63.129.16", "192.0.0.192",
        "224.0.0.1", "240.0.0.1", "255.255.255.255", "198.18.0.1", "192.0.2.1",
        "::", "::1", "fe80::1", "fe80::1%eth0", "fc00::1", "fd00:ec2::254", "ff0e::1",
        "2001:db8::1", "2001::1", "5f00::1", "fec0::1",
        "::ffff:127.0.0.1", "::ffff:169.254.169.254", "::ffff:10.0.0.1",
        "64:ff9b::7f00:1", "64:ff9b::a9fe:a9fe", "64:ff9b:1::a00:1", "2002:7f00:1::",
        "2002:a9fe:a9fe::1",
    ],
)  # fmt: skip
def test_private_addresses(address: str) -> None:
    assert not is_public(ipaddress.ip_address(address))


@pytest.mark.parametrize(
    "address",
    ["1.1.1.1", "93.184.216.34", "2606:4700::1111", "::ffff:1.1.1.1", "64:ff9b::101:101"],
)
def test_public_addresses(address: str) -> None:
    assert is_public(ipaddress.ip_address(address))


@pytest.mark.parametrize(
    "host",
    ["127.0.0.1", "localhost", "127.1", "2130706433", "0x7f.1", "0.0.0.0", "[::1]",
     "[::ffff:127.0.0.1]", "[::ffff:7f00:1]"],
)  # fmt: skip
def test_this_machine_is_refused_by_every_name(host: str, data: bytes) -> None:
    with serving(FaultServer(data)) as server:
        for work in (cogsplat.open, cogsplat.decode):
            with pytest.raises(cogsplat.StorageError) as caught:
                work(f"http://{host}:{server.port}/a.cogs", network=PUBLIC)
            # Some resolvers do not know every notation.
            assert caught.value.code in ("private-address", "host-unreachable")
    assert server.connections == 0


def test_proxies_of_the_environment_are_not_used(
    data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(FaultServer(data)) as server:
        monkeypatch.setenv("HTTP_PROXY", server.url(""))
        monkeypatch.setenv("http_proxy", server.url(""))
        with pytest.raises(cogsplat.StorageError) as caught:
            cogsplat.open("http://10.0.0.1/a.cogs", network=PUBLIC)
        assert caught.value.code == "private-address"
    assert server.connections == 0


def test_object_stores_are_refused(data: bytes) -> None:
    with serving(FaultServer(data)) as server:
        store = {"endpoint": f"http://127.0.0.1:{server.port}", "skip_signature": "true"}
        network = NetworkOptions(allow_private=False, options_of_store=store)
        with pytest.raises(cogsplat.StorageError, match="object stores") as caught:
            cogsplat.open("s3://bucket/a.cogs", network=network)
        assert caught.value.code == "private-address"
    assert server.connections == 0


class Internet:
    """Names and public addresses, and the local server that a connection to each goes to."""

    def __init__(self) -> None:
        self.addresses: dict[str, list[str]] = {}
        self.ports: dict[str, int] = {}
        self.resolved: list[str] = []
        self.connected: list[str] = []

    async def resolve(self, host: str, port: int, **options: object) -> list[tuple[Any, ...]]:
        self.resolved.append(host)
        found = self.addresses.get(host, [host])
        # What a hostile name server says next.
        self.addresses[host] = [*found[1:], "127.0.0.1"] if len(found) > 1 else found
        family = socket.AF_INET6 if ":" in found[0] else socket.AF_INET
        return [(family, socket.SOCK_STREAM, 6, "", (found[0], port))]

    async def connect(
        self, network: object, host: str, port: int, *rest: object
    ) -> httpcore.AsyncNetworkStream:
        self.connected.append(host)
        if host not in self.ports:
            raise httpcore.ConnectError("no such server")
        return await CONNECT(network, "127.0.0.1", self.ports[host], *rest)  # type: ignore[arg-type]


CONNECT = httpcore.AnyIOBackend.connect_tcp


@contextmanager
def internet(monkeypatch: pytest.MonkeyPatch) -> Iterator[Internet]:
    """Lead connections to public addresses to servers of this machine."""
    made = Internet()

    async def resolve(
        loop: object, host: str, port: int, **options: object
    ) -> list[tuple[Any, ...]]:
        return await made.resolve(host, port, **options)

    async def connect(
        network: object, host: str, port: int, *rest: object
    ) -> httpcore.AsyncNetworkStream:
        return await made.connect(network, host, port, *rest)

    with monkeypatch.context() as patch:
        patch.setattr("asyncio.base_events.BaseEventLoop.getaddrinfo", resolve)
        patch.setattr(httpcore.AnyIOBackend, "connect_tcp", connect)
        yield made


def test_public_servers_are_read_by_ranges_with_retries(
    data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults = [right, status(503), broken_after(20_000)]
    with serving(FaultServer(data, faults)) as server, internet(monkeypatch) as net:
        net.addresses["a.example"] = ["93.184.216.34"]
        net.ports["93.184.216.34"] = server.port
        found = cogsplat.decode("http://a.example/scene.cogs", network=PUBLIC)
    assert_same(found, cogsplat.decode(data))
    assert server.asked[0].headers["host"] == "a.example"
    assert set(net.connected) == {"93.184.216.34"}


def test_objects_of_a_folder_are_read_as_well(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    objects = folder_of_file(data)

    async def one_object(exchange: Exchange) -> None:
        exchange.server.data = objects[exchange.asked.path.removeprefix("/s/")]
        await right(exchange)

    with serving(FaultServer(b"", always=one_object)) as server, internet(monkeypatch) as net:
        net.addresses["a.example"] = ["2606:4700::1111"]
        net.ports["2606:4700::1111"] = server.port
        source = open_source("http://a.example/s/", PUBLIC)
        assert source.read(0, source.size) == data
        source.close()


@pytest.mark.parametrize(
    "target",
    ["http://127.0.0.1:{port}/a", "http://[::1]:{port}/a", "http://[::ffff:127.0.0.1]:{port}/a",
     "http://inside.example:{port}/a", "http://169.254.169.254/latest/meta-data/"],
)  # fmt: skip
def test_redirects_to_private_addresses_are_refused(
    target: str, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(FaultServer(data)) as inside:
        away = status(302, Location=target.format(port=inside.port))
        with serving(FaultServer(data, always=away)) as outside, internet(monkeypatch) as net:
            net.addresses |= {"a.example": ["1.1.1.1"], "inside.example": ["10.1.2.3"]}
            net.ports |= {"1.1.1.1": outside.port, "10.1.2.3": inside.port}
            with pytest.raises(cogsplat.StorageError) as caught:
                cogsplat.open("http://a.example/a.cogs", network=PUBLIC)
            assert caught.value.code == "private-address"
            assert net.connected == ["1.1.1.1"]
    assert inside.connections == 0


def test_a_redirect_in_the_middle_of_a_file_is_refused(
    data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(FaultServer(data)) as inside:
        away = status(307, Location=inside.url())
        with (
            serving(FaultServer(data, [right], always=away)) as outside,
            internet(monkeypatch) as net,
        ):
            net.addresses["a.example"] = ["1.1.1.1"]
            net.ports["1.1.1.1"] = outside.port
            with cogsplat.open("http://a.example/a.cogs", network=PUBLIC) as file:
                with pytest.raises(cogsplat.StorageError) as caught:
                    file.decode()
                assert caught.value.code == "private-address"
    assert inside.connections == 0


def test_a_name_server_that_changes_its_mind_gains_nothing(
    data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """DNS rebinding: the connection goes to the address that was checked."""
    with (
        serving(FaultServer(data, always=broken_after(20_000))) as server,
        internet(monkeypatch) as net,
    ):
        net.addresses["a.example"] = ["1.1.1.1", "1.1.1.1", "127.0.0.1"]
        net.ports |= {"1.1.1.1": server.port, "127.0.0.1": server.port}
        with pytest.raises(cogsplat.StorageError) as caught:
            cogsplat.decode("http://a.example/a.cogs", network=PUBLIC)
    assert caught.value.code == "private-address"
    assert set(net.connected) == {"1.1.1.1"}
    # Each connection resolved the name once.
    assert len(net.resolved) > len(net.connected)


def test_of_several_addresses_the_private_ones_are_passed_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def several(host: str, port: int) -> list[ipaddress.IPv4Address]:
        texts = ("10.0.0.1", "8.8.8.8", "1.1.1.1")
        return [ipaddress.IPv4Address(text) for text in texts]

    monkeypatch.setattr(public_transport, "_resolve", several)
    with serving(FaultServer(b"")) as server, internet(monkeypatch) as net:
        # The first public one does not answer.
        net.ports |= {"10.0.0.1": server.port, "1.1.1.1": server.port}
        with pytest.raises(cogsplat.CogsplatError):
            cogsplat.open("http://a.example/a.cogs", network=PUBLIC)
        assert set(net.connected) == {"8.8.8.8", "1.1.1.1"}
