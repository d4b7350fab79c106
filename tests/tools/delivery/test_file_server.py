import datetime
import ssl
import sys

import httpx
import numpy as np
import pytest
from cogs_samples import assert_same, file_of

import cogsplat
from cogsplat.codec.errors import MissingExtraError, StorageError
from cogsplat.formats.network import http_transport
from cogsplat.tools.delivery.file_app import FileApp
from cogsplat.tools.delivery.file_server import Certificate, FileServer, running
from cogsplat.tools.delivery.shaped_link import LinkQuality, ShapedLink


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.cogs"
    path.write_bytes(file_of("vq", 6000, 3, 500))
    return path


def served(path, certificate=None, **quality):
    app = FileApp(path, ShapedLink(LinkQuality(**quality)))
    return running(FileServer(app, certificate=certificate))


def test_a_scene_is_read_from_it(scene):
    with served(scene) as server, cogsplat.open(server.url + "scene.cogs") as file:
        assert_same(file.decode(), cogsplat.decode(scene))
        assert file.traffic.received_bytes <= scene.stat().st_size


def test_a_bad_link_gives_the_same_scene(scene):
    network = cogsplat.NetworkOptions(pause_seconds=0.01, retries=20)
    bad = {"loss": 0.4, "fail_rate": 0.3, "bits_per_second": 50e6, "latency_seconds": 0.005}
    failures = 0
    for seed in range(3):
        with (
            served(scene, seed=seed, **bad) as server,
            cogsplat.open(server.url + "scene.cogs", network=network) as file,
        ):
            assert_same(file.decode(), cogsplat.decode(scene))
            failures += file.traffic.failures
    assert failures


def test_http2_with_a_certificate(scene, tmp_path, monkeypatch):
    pytest.importorskip("cryptography", reason="needs cryptography")
    certificate = made_certificate(tmp_path)
    context = ssl.create_default_context(cafile=certificate.certificate)
    clients = []

    def new_client(options):
        clients.append(httpx.AsyncClient(http2=True, verify=context, event_hooks=hooks))
        return clients[-1]

    versions = set()

    async def seen(response):
        versions.add(response.http_version)

    hooks = {"response": [seen]}
    monkeypatch.setattr(http_transport, "new_client", new_client)
    with served(scene, certificate) as server:
        assert server.url.startswith("https://")
        assert_same(cogsplat.decode(server.url + "scene.cogs"), cogsplat.decode(scene))
    assert versions == {"HTTP/2"}


def made_certificate(folder):
    """Sign a certificate for this machine with its own key."""
    from ipaddress import ip_address

    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "test")])
    today = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(today - datetime.timedelta(days=1))
        .not_valid_after(today + datetime.timedelta(days=1))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), critical=False
        )
        .sign(key, hashes.SHA256())
    )
    files = Certificate(folder / "cert.pem", folder / "key.pem")
    files.certificate.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    files.key.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    return files


def test_a_port_in_use_is_an_error(scene):
    with served(scene) as server:
        app = FileApp(scene, ShapedLink(LinkQuality()))
        with pytest.raises(StorageError, match=str(server.port)):
            FileServer(app, server.port)


def test_stopping_before_it_began(scene):
    server = FileServer(FileApp(scene, ShapedLink(LinkQuality())))
    server.stop()
    server.serve_forever()
    server.close()


def test_the_missing_extra_is_named(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "hypercorn.asyncio.tcp_server", None)
    with pytest.raises(MissingExtraError, match=r"cogsplat\[serve\]"):
        FileServer(FileApp(scene, ShapedLink(LinkQuality())))


def test_many_readers_at_once(scene):
    """A short form of `tools.lab.benchmark.many_readers`."""
    data = scene.read_bytes()
    rng = np.random.default_rng(1)

    async def read(client, url):
        first = int(rng.integers(0, len(data) - 5000))
        headers = {"Range": f"bytes={first}-{first + 4999}"}
        answer = await client.get(url, headers=headers)
        return answer.content == data[first : first + 5000]

    async def all_of_them(url):
        limits = httpx.Limits(max_connections=50)
        async with httpx.AsyncClient(limits=limits, timeout=60) as client:
            return await asyncio.gather(*(read(client, url) for _ in range(400)))

    import asyncio

    with served(scene) as server:
        assert all(asyncio.run(all_of_them(server.url + "scene.cogs")))
