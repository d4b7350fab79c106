"""Limits of SPEC 9.1 that concern single payloads."""

from __future__ import annotations

from typing import Final

MAX_CHUNK_SPLATS: Final = 1 << 18
"""Maximum number of splats in a chunk (SPEC 9.1)."""


MAX_PLANE_BYTES: Final = 8 * 1024 * 1024
"""Maximum size of a decoded plane, bytes (SPEC 9.1)."""

MAX_WINDOW_BYTES: Final = 8 * 1024 * 1024
"""Largest zstd window, bytes: the limit of browsers (RFC 9659)."""


MAX_STREAMS: Final = 64
"""Maximum number of streams in a segment (SPEC 9.1)."""

MAX_CODEBOOK_ROWS: Final = 1 << 16
"""Maximum number of rows of a codebook (SPEC 9.1)."""
