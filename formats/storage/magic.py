"""Magic bytes of known file types, for messages about unexpected files."""

from __future__ import annotations

from typing import Final

COGS_MAGIC: Final = b"\x89COGS\r\n\x1a"
"""First bytes of a COGS file (SPEC 3.1). Their line end exposes transfers in text mode."""

MANIFEST_MAGIC: Final = b"\x89COGM\r\n\x1a"
"""First bytes of the manifest of a COGS folder (SPEC 3.4)."""

_MAGICS: Final = (
    (COGS_MAGIC, "a COGS file"),
    (MANIFEST_MAGIC, "the manifest of a COGS folder"),
    (COGS_MAGIC[::-1], "a COGS magic in reverse byte order"),
    (b"version https://git-lfs", "a Git LFS pointer in place of the file"),
    (b"ply", "a PLY file"),
    (b"\x1f\x8b", "gzip, as SPZ up to version 3"),
    (b"NGSP", "SPZ version 4"),
    (b"PK\x03\x04", "a ZIP file, as SOG"),
    (b"RAD0", "Spark RAD"),
    (b"\x28\xb5\x2f\xfd", "zstd data"),
    (b"glTF", "binary glTF"),
    (b"\x89PNG", "a PNG image"),
    (b"RIFF", "a RIFF file, as WebP"),
    (b"<", "markup, as an error page of a server"),
    (b"{", "a JSON object"),
    (b"[", "a JSON array"),
)


def describe(head: bytes) -> str:
    """Return a phrase for the type of a file with the first bytes `head`, such as "a PLY file"."""
    if not head:
        return "an empty file"
    for magic, name in _MAGICS:
        if head.startswith(magic):
            return f"{name} (it starts with {head[:8].hex(' ')})"
    return f"a file that starts with {head[:8].hex(' ')}"
