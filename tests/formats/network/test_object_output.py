"""Objects of a store as outputs, to a server that speaks S3."""

import obstore
import pytest
from s3_server import s3_server

from cogsplat.codec.errors import StorageError
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.object_output import ObjectOutput
from cogsplat.formats.network.object_transport import object_store
from cogsplat.formats.storage.atomic import TargetExistsError

URL = "s3://bucket/scenes/a.cogs"


@pytest.fixture(scope="module")
def options():
    with s3_server() as server:
        store = {
            "endpoint": server,
            "region": "us-east-1",
            "access_key_id": "key",
            "secret_access_key": "secret",
        }
        yield NetworkOptions(options_of_store=store, retries=1)


# The last is sent in several parts.
@pytest.mark.parametrize("size", [0, 5000, 12_000_000])
def test_a_file_becomes_an_object(options, tmp_path, size):
    path = tmp_path / "a"
    path.write_bytes(bytes(range(250)) * (size // 250))
    url = f"s3://bucket/{size}.cogs"
    output = ObjectOutput(url, options)
    assert output.size() is None
    output.require_absent()
    output.write(path)
    assert output.size() == size
    found = obstore.get(object_store(url, options, retries=0), f"{size}.cogs")
    assert found.attributes["Content-Type"] == "application/octet-stream"
    assert found.bytes().to_bytes() == path.read_bytes()


def test_an_object_is_replaced_only_by_force(options, tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"first")
    output = ObjectOutput(URL, options)
    output.write(path)
    path.write_bytes(b"second")
    with pytest.raises(TargetExistsError, match=r"s3://bucket/scenes/a\.cogs: exists"):
        output.write(path)
    assert output.size() == 5
    output.write(path, force=True)
    assert output.size() == 6


def test_failures_are_told_with_the_address(options, tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"data")
    with pytest.raises(StorageError, match="s3://no-such-bucket/a: ") as caught:
        ObjectOutput("s3://no-such-bucket/a", options).write(path)
    assert caught.value.code == "store-failed"
    nobody = {"endpoint": "http://127.0.0.1:9", "skip_signature": "true"}
    gone = NetworkOptions(options_of_store=nobody, retries=0)
    with pytest.raises(StorageError) as caught:
        ObjectOutput(URL, gone).size()
    assert caught.value.code == "store-failed"
