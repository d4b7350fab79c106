"""Limits of SPEC 9.1 that concern single payloads."""

from __future__ import annotations

from typing import Final

MAX_CHUNK_SPLATS: Final = 1 << 18
"""Splats of a chunk at most (SPEC 9.1)."""


MAX_PLANE_BYTES: Final = 8 * 1024 * 1024
"""Bytes of a decoded plane at most (SPEC 9.1)."""

MAX_WINDOW_BYTES: Final = 8 * 1024 * 1024
"""Largest zstd window, bytes: the limit of browsers (RFC 9659)."""


MAX_STREAMS: Final = 64
"""Streams of a segment at most (SPEC 9.1)."""

MAX_CODEBOOK_ROWS: Final = 1 << 16
"""Rows of a codebook at most (SPEC 9.1)."""
