"""Buffers inside a glTF's JSON, taken out of the text before it is parsed.

Parsed as strings they would be in memory three times: as bytes of the file, as text and as a value.
"""

from __future__ import annotations

import binascii
import re
from dataclasses import dataclass
from typing import Final

from cogsplat.codec.errors import FormatError, UnsupportedError

# Shorter ones stay in the text, where messages show them. The first quote is not escaped, so that a
# string is taken whole or not at all; asked behind it, for `re` skips to a first character alone.
_LONG_URI: Final = re.compile(rb'"(?<!\\")data:[^",\\]{0,120},[A-Za-z0-9+/=]{256,}"')

_PLACEHOLDER: Final = "data:embedded-{}"


@dataclass(frozen=True)
class Embedded:
    """The text of a file without its long ``data:`` URIs, and these.

    Parameters
    ----------
    text : bytes
        JSON, with a short name in place of each.
    uris : dict of str to memoryview
        By these names.
    """

    text: bytes
    uris: dict[str, memoryview]

    def decode(self, uri: str, where: str) -> memoryview:
        """Return the bytes of a ``data:`` URI.

        Raises
        ------
        UnsupportedError
            ``gltf-uri``: it is not in base64.
        FormatError
            ``gltf-bad-buffer``: what follows is no base64.
        """
        whole = self.uris.get(uri)
        if whole is None:
            whole = memoryview(uri.encode("utf-8", "replace"))
        comma = bytes(whole[:128]).find(b",")
        head = bytes(whole[: comma if comma >= 0 else 128])
        if comma < 0 or not head.endswith(b";base64"):
            shown = head[:60].decode("utf-8", "replace")
            raise UnsupportedError("gltf-uri", f"{where}: {shown!r}, expected base64")
        try:
            return memoryview(binascii.a2b_base64(whole[comma + 1 :], strict_mode=True))
        except ValueError as error:
            raise FormatError("gltf-bad-buffer", f"{where}: {error}, expected base64") from error


def take_out(data: bytes) -> Embedded:
    """Take the long ``data:`` URIs out of JSON text.

    Parameters
    ----------
    data : bytes
        The text; it stays in memory as long as the result does, which shows parts of it.
    """
    pieces: list[bytes] = []
    uris: dict[str, memoryview] = {}
    end = 0
    view = memoryview(data)
    for match in _LONG_URI.finditer(data):
        name = _PLACEHOLDER.format(len(uris))
        uris[name] = view[match.start() + 1 : match.end() - 1]
        pieces += [data[end : match.start()], f'"{name}"'.encode()]
        end = match.end()
    return Embedded(b"".join([*pieces, data[end:]]) if pieces else data, uris)
