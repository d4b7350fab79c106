"""Extraction of base64 buffers from a glTF's JSON before it is parsed.

A buffer parsed as a JSON string would be in memory three times: as bytes of the file, as text and
as a value.
"""

from __future__ import annotations

import binascii
import re
from dataclasses import dataclass
from typing import Final

from cogsplat.codec.errors import FormatError, UnsupportedError

# A whole JSON string that is a long data URI. Short URIs stay in the text, where messages show
# them. The lookbehind rejects an escaped first quote. It follows the quote, because `re` scans
# fast only for a literal first character.
_LONG_URI: Final = re.compile(rb'"(?<!\\")data:[^",\\]{0,120},[A-Za-z0-9+/=]{256,}"')

_PLACEHOLDER: Final = "data:embedded-{}"


@dataclass(frozen=True)
class EmbeddedBuffers:
    """A glTF's JSON text, with placeholders for its long ``data:`` URIs, and the URIs.

    Parameters
    ----------
    text : bytes
        JSON with a placeholder for each long URI.
    uris : dict of str to memoryview
        Long URIs by placeholder.
    """

    text: bytes
    uris: dict[str, memoryview]

    def decode(self, uri: str, where: str) -> memoryview:
        """Return the decoded bytes of a ``data:`` URI.

        Parameters
        ----------
        uri : str
            A placeholder, or a short URI itself.
        where : str
            Location for messages.

        Raises
        ------
        UnsupportedError
            ``gltf-uri``: the URI does not declare base64.
        FormatError
            ``gltf-bad-buffer``: the data are not valid base64.
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


def extract_buffers(data: bytes) -> EmbeddedBuffers:
    """Replace the long ``data:`` URIs of JSON text with placeholders.

    Parameters
    ----------
    data : bytes
        JSON text. The result holds views of it, which keep it in memory.
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
    return EmbeddedBuffers(b"".join([*pieces, data[end:]]) if pieces else data, uris)
