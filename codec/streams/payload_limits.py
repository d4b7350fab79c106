"""The limits of SPEC 9.1 that a payload alone can break."""

from __future__ import annotations

from typing import Final

MAX_CHUNK_SPLATS: Final = 1 << 18
"""Most splats a chunk may hold (SPEC 9.1)."""


MAX_PLANE_BYTES: Final = 8 * 1024 * 1024
"""Largest decoded plane, bytes (SPEC 9.1)."""

MAX_WINDOW_BYTES: Final = 8 * 1024 * 1024
"""Largest zstd window a reader must provide: what browsers accept (RFC 9659)."""


MAX_STREAMS: Final = 64
"""Most streams in one segment (SPEC 9.1)."""

MAX_CODEBOOK_ROWS: Final = 1 << 16
"""Most rows of one codebook (SPEC 9.1)."""
