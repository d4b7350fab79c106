import base64
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.codec.errors import CogsplatError
from cogsplat.formats.scenes.gltf.embedded_buffers import extract_buffers

HEAD = "data:application/octet-stream;base64,"


@given(st.lists(st.binary(max_size=600), max_size=4), st.sampled_from([None, 2]))
def test_buffers_come_back_and_the_rest_of_the_text_stays(
    buffers: list[bytes], indent: int | None
) -> None:
    uris = [HEAD + base64.b64encode(data).decode() for data in buffers]
    value = {"asset": {"version": "2.0"}, "buffers": [{"uri": uri} for uri in uris], "z": "é"}
    embedded = extract_buffers(json.dumps(value, indent=indent).encode())
    left = json.loads(embedded.text)
    assert left["asset"] == value["asset"]
    assert left["z"] == "é"
    assert len(embedded.text) < 1000 + 400 * len(buffers)
    assert [bytes(embedded.decode(b["uri"], "a")) for b in left["buffers"]] == buffers


def test_text_in_strings_is_no_buffer() -> None:
    inner = f'"{HEAD}{"A" * 400}"'
    embedded = extract_buffers(json.dumps({"name": inner}).encode())
    assert json.loads(embedded.text) == {"name": inner}


@pytest.mark.parametrize(
    ("uri", "code"),
    [
        (HEAD + "A" * 401, "gltf-bad-buffer"),
        (HEAD + "AA=A" * 100, "gltf-bad-buffer"),
        ("data:application/octet-stream," + "A" * 400, "gltf-uri"),
        (HEAD + "*", "gltf-bad-buffer"),
        ("data:", "gltf-uri"),
        ("data:text/plain;base64", "gltf-uri"),
        ("data:é,", "gltf-uri"),
    ],
)
def test_invalid_base64_is_refused(uri: str, code: str) -> None:
    embedded = extract_buffers(json.dumps({"uri": uri}, ensure_ascii=False).encode())
    with pytest.raises(CogsplatError) as caught:
        embedded.decode(json.loads(embedded.text)["uri"], "a.gltf")
    assert caught.value.code == code
