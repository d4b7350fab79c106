"""How long work reports: one callback, which may also stop it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``; raising `Cancelled` from it stops the work."""


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""
